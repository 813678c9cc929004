"""Free swimming: gaits, the steady state as a root, performance and reports. May import `batch` and
the rooms below it."""
