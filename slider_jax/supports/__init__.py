"""How the head is held: one support a file."""

from slider_jax.supports.base import Support
from slider_jax.supports.clamped import Clamped
from slider_jax.supports.free import Free
from slider_jax.supports.pinned import PinnedLink

__all__ = ["Clamped", "Free", "PinnedLink", "Support"]
