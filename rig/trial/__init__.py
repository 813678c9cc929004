"""Plays a drive, records the sensors, and runs trial after trial. May import `camera`, `force`,
`manifold` and the rooms below them."""
