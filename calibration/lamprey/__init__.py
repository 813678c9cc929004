"""Computes the axial force balance of a swimming lamprey from its measured midlines. This package
may import `reporting`, `inference` and packages of lower layers."""
