"""Files: atomic writing, provenance, CSV, TOML, units and figures. May import `errors`."""
