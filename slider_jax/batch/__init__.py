"""Runs many robots at once, stride by stride, on all cores. May import `simulation` and the rooms
below it."""
