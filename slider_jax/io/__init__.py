"""Reads and writes files: TOML, CSV, figures, units and provenance. This package may import
`errors`."""
