"""Compares the paper's published free-swimming speeds with its equations. May import `discrepancy`
and the rooms below it."""
