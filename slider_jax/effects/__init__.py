"""Physical effects, one a file."""

from slider_jax.effects.base import ForceDensity as ForceDensity, total_force as total_force
from slider_jax.effects.drag import NormalDrag as NormalDrag
from slider_jax.effects.gravity import Gravity as Gravity
from slider_jax.effects.reactive import ReactiveForce as ReactiveForce
