"""Measured trials, and simulated tanks with known parameters. This package may import `model`."""
