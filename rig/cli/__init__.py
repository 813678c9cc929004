"""The rig's commands. They may import all packages. Only the table of commands refers to them."""
