"""Measured trials, and simulated trials with known parameters. This package may import `model`."""
