"""The calibration's commands. They may import all packages. Only the command table imports them."""
