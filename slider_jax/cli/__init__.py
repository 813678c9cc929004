"""The `slider` command. May import every package of the project; nothing imports it."""
