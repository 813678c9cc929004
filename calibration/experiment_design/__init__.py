"""Predicts the information of trials and proposes the next trial. May import `discrepancy` and the
rooms below it."""
