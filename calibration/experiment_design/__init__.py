"""Predicts what trials would tell and proposes the next one. May import `discrepancy` and the rooms
below it."""
