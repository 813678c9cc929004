"""Measured trials as records, findings about them, and synthetic tanks with a known answer. May
import `model`."""
