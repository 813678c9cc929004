"""The `slider` command. This package may import every package of the project. No other package
imports `cli`."""
