"""Evaluates the axial force balance of a swimming lamprey from its measured midlines. May import
`reporting`, `inference` and the rooms below them."""
