"""Effects of the water; may import `effects` and the rooms below it."""
