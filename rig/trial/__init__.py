"""Plays a drive, records the sensors, and runs an experiment's trials. May import `camera`,
`force`, `manifold` and the rooms below them."""
