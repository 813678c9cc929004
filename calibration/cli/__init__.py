"""The calibration's commands. May import every room; only the table of commands names them."""
