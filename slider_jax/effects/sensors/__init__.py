"""Effects of the sensors. This package may import `effects` and lower layers."""
