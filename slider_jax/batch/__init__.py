"""Simulates batches of robots, one stride at a time, on all cores. This package may import
`simulation` and packages of lower layers."""
