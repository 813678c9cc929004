"""Identifies stiffness, damping and K_Q from a bench in air. May import `inference` and the rooms
below it."""
