"""Finds faults of sensors, clocks, units and columns in measured trials before anything is fitted.
May import `measurements` and `model`."""
