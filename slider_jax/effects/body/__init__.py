"""Effects of the body and the mounting. This package may import `effects` and lower layers."""
