"""Identifies stiffness, damping and K_Q from bench tests in air. This package may import
`inference` and packages of lower layers."""
