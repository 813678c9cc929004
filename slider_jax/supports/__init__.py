"""Supports of the head: clamped, free or pinned, one support in each file. May import `beam`."""

from slider_jax.supports.base import Support
from slider_jax.supports.clamped import Clamped
from slider_jax.supports.free import Free
from slider_jax.supports.pinned import PinnedLink

__all__ = ["Clamped", "Free", "PinnedLink", "Support"]
