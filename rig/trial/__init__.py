"""Plays drives, records the sensors, and runs all trials of an experiment. This package may import
`camera`, `force`, `manifold` and packages of lower layers."""
