"""Messages and frames of the serial protocols, without input or output. May import `errors`."""
