"""Computes the axial force balance of a swimming lamprey from the measured midlines of the animal.
This package may import `reporting`, `inference` and packages of lower layers."""
