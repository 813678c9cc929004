"""Computes marker positions in metres from camera frames. This package may import `recording` and
`protocol`."""
