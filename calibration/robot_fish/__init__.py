"""Predicts the speed of a tendon-driven robot fish from its markers or from its beat frequency.
This package may import `reporting` and packages of lower layers."""
