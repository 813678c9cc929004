"""Effects of the water. This package may import `effects` and lower layers."""
