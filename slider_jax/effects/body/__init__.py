"""Effects of the body and its mounting. They may import `effects` and lower layers."""
