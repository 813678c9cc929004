"""Messages and frames of the serial protocols; no input or output. May import `errors`."""
