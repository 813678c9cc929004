"""Simulates a robot in three dimensions. This room may import `dynamics` and all rooms below it."""
