"""Effects of the body and its mounting. This package may import `effects` and packages of lower
layers."""
