"""Encodes and decodes the serial protocols' messages. This package may import `errors`."""
