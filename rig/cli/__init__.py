"""The rig's commands. This package may import all packages. Only the table of commands uses it."""
