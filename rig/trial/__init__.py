"""Plays a drive, records the sensors, and runs an experiment's trials.
This package may import `camera`, `force`, `manifold` and packages of lower layers."""
