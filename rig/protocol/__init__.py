"""Encodes and decodes the messages of the serial protocols, without input or output. This package
may import `errors`."""
