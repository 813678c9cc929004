"""Runs the calibrated model beside a live stream, follows k and K_Q, and raises alarms. May import
`inference`, `audit` and the rooms below them."""
