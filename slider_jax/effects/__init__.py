"""Physical effects, one a file."""

from slider_jax.effects.base import ForceDensity, total_force
from slider_jax.effects.drag import NormalDrag
from slider_jax.effects.gravity import Gravity
from slider_jax.effects.reactive import ReactiveForce

__all__ = ["ForceDensity", "Gravity", "NormalDrag", "ReactiveForce", "total_force"]
