"""Identification of parameters from measured trials, also by drive frequency. May import
`experiment_design` and the rooms below it."""
