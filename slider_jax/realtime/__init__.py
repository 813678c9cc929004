"""Steps one robot while it is driven: set pressures and readings without knowledge of the future,
faults and noise. May import `simulation` and the rooms below it."""
