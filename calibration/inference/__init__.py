"""Fits parameters by least squares: noise model, optimisers, intervals, and a cache of simulations.
This package may import `measurements` and `model`."""
