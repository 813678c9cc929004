"""Supports of the head: clamped, free, pinned and gripping. This package may import the package
`beam`."""

from slider_jax.supports.base import Support as Support
from slider_jax.supports.clamped import Clamped as Clamped
from slider_jax.supports.free import Free as Free
from slider_jax.supports.gripping import (
    GrippingLink as GrippingLink,
    GripState as GripState,
    Spines as Spines,
)
from slider_jax.supports.pinned import PinnedLink as PinnedLink
