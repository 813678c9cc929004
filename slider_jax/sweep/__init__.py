"""Varies one or two numbers of an experiment over ranges. This package may import `swimming` and
packages of lower layers."""
