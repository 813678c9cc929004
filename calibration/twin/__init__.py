"""Runs the calibrated model in parallel with a live stream, estimates k and K_Q, and raises alarms.
May import `inference`, `audit` and the rooms below them."""
