"""Learns a function from a dictionary of terms if no effect of the library explains the residual,
or if the named effects are doubtful.
This package may import `experiment_design`, `discrepancy` and packages of lower layers."""
