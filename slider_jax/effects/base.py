"""What an effect is: one physical cause, its parameters as leaves, and the one method that adds it.

A model is a list of effects; the solver never knows which. `ForceDensity` is the place for
everything that pushes on the body along its length; pressure, waveform and support have base
classes of their own, beside their kinds.
"""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from slider_jax.beam import Section


class ForceDensity(eqx.Module):
    """A force per unit length on the body."""

    @abstractmethod
    def force(self, x: Section) -> tuple[Array, Array]:
        """(F_tau, F_n) [N/m] on a section of the body."""


def total_force(effects: tuple[ForceDensity, ...], x: Section) -> tuple[Array, Array]:
    """Sum of the effects' force densities [N/m]."""
    zero = jnp.zeros_like(x.V_n)
    parts = [effect.force(x) for effect in effects]
    return sum((p[0] for p in parts), zero), sum((p[1] for p in parts), zero)
