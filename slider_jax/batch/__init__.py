"""Simulates batches of robots on all cores, one stride at a time. It may import `simulation` and
lower layers."""
