"""Functions of a local state as sums of powers, for terms of the dictionary."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import parameter

WHY = "20 times the unit of the term is more than any known law adds"


def odd_powers(z: Array) -> Float[Array, "3 ..."]:
    """Returns z, z |z| and z^3. Beyond -1 and 1, each function is constant."""
    z = jnp.clip(z, -1.0, 1.0)
    return jnp.stack([z, z * jnp.abs(z), z**3])


def even_powers(z: Array) -> Float[Array, "3 ..."]:
    """Returns |z|, z^2 and |z|^3. Beyond -1 and 1, each function is constant."""
    size = jnp.minimum(jnp.abs(z), 1.0)
    return jnp.stack([size, size**2, size**3])


class Powers(eqx.Module):
    """A sum of three functions of a state, each multiplied by a parameter."""

    a: Scalar = parameter(0.0, -20.0, 20.0, "-", WHY)
    """Factor of the first function."""
    b: Scalar = parameter(0.0, -20.0, 20.0, "-", WHY)
    """Factor of the second function."""
    c: Scalar = parameter(0.0, -20.0, 20.0, "-", WHY)
    """Factor of the third function."""

    def total(self, basis: Float[Array, "3 ..."]) -> Array:
        """Returns the sum of the basis functions, each multiplied by its parameter."""
        return self.a * basis[0] + self.b * basis[1] + self.c * basis[2]
