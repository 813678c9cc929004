"""Effects of the water. This package may import `effects` and packages of lower layers."""
