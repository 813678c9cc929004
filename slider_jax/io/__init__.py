"""Reads and writes TOML, CSV and figures, with units. This package may import `errors`."""
