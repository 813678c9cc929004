"""Fits parameters by least squares: noise model, optimisers, intervals and cached fits. This
package may import `measurements` and `model`."""
