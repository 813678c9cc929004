"""The commands of the calibration. These modules may import all packages. No module imports them,
except the table of commands in `slider_jax.cli`."""
