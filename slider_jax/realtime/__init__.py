"""Simulates one robot in real time from set pressures to readings, with faults. May import
`simulation` and the rooms below it."""
