"""Marker positions in metres from camera frames. May import `recording` and `protocol`."""
