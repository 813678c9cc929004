"""Supports of the head: clamped, free or pinned, one support in each file. May import `beam`."""

from slider_jax.supports.base import Support as Support
from slider_jax.supports.clamped import Clamped as Clamped
from slider_jax.supports.free import Free as Free
from slider_jax.supports.pinned import PinnedLink as PinnedLink
