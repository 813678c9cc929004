"""The rig's commands. They may import all packages; only the table of commands refers to them."""
