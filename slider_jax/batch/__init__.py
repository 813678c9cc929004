"""Simulates batches of robots by strides on all cores. May import `simulation` and the rooms below
it."""
