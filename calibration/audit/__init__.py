"""Finds faults of sensors, clocks, units and columns in measured trials before the fit. This
package may import `measurements` and `model`."""
