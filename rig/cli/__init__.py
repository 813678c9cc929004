"""The rig's commands. May import every room; only the table of commands refers to them."""
