"""Frames of a camera to marker positions in metres. May import `recording` and `protocol`."""
