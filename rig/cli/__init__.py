"""Commands of the rig. This package may import all packages. Only the table of commands refers to
them."""
