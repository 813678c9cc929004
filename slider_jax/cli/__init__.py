"""The `slider` command, which may import all packages. No other package imports `cli`."""
