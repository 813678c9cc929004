"""Reproduces the paper's frequency sweep, performance table and design maps. May import
`climbing`, `sweep` and the rooms below them."""
