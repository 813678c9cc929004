"""Identifies the simulator's parameters from measured data and finds missing effects."""
