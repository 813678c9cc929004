"""HTML pages, and fitted parameters as text, JSON and TOML. May import `inference` and the rooms
below it."""
