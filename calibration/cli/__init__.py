"""Commands of the calibration. This package may import all packages. Only the table of commands
refers to them."""
