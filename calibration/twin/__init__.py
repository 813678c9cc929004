"""Runs the calibrated model in parallel with a live stream, estimates k and K_Q, and raises alarms.
This package may import `inference`, `audit` and packages of lower layers."""
