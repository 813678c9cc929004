"""Effects of the water. They may import `effects` and lower layers."""
