"""Identification of the simulator's parameters from measurements."""
