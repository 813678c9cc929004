"""Messages and frames of the serial protocols, without input or output.
This package may import `errors`."""
