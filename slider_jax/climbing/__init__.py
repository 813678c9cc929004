"""Climbing in air, pinned to a wall: strides, performance, table, picture and film. May import
`swimming` and the rooms below it."""
