"""Effects of the sensors. They may import `effects` and lower layers."""
