"""Weighs the axial force balance of a swimming lamprey's measured midlines. May import `reporting`,
`inference` and the rooms below them."""
