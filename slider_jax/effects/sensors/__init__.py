"""Effects of the sensors. This package may import `effects` and packages of lower layers."""
