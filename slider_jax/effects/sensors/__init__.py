"""Effects of the sensors; may import `effects` and the rooms below it."""
