"""Finds missing effects: scores, refits, selection, verdict and report. This package may import
`reporting`, `inference`, `audit` and packages of lower layers."""
