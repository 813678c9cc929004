"""Sweeps one or two numbers of an experiment over ranges. May import `swimming` and the rooms below
it."""
