"""Effects of the body and its mounting; may import `effects` and the rooms below it."""
