"""Writes HTML pages, and writes fitted parameters as text, JSON and TOML. This package may import
`inference` and packages of lower layers."""
