"""Least squares on whitened residuals: problem, optimisers, noise, intervals, uncertainty and
cache. May import `measurements` and `model`."""
