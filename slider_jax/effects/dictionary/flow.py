"""Terms of the flow into a chamber."""

from abc import abstractmethod

import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Chamber, Curve, Flow, parameter
from slider_jax.effects.functions import magnitude

PRESSURE, DIFFERENCE = 200e3, 300e3
"""Pressure p and difference p_set - p [Pa] of a typical drive with 250 kPa. A parameter is the
contribution of its basis function at this value."""
CORNER = 0.02
"""Width of the smooth corner of the square root, as a fraction of `DIFFERENCE`."""
WHY = "dp/dt at a difference of 250 kPa and k = 0.08 s is 3 MPa/s"
WHY_FACTOR = "1/k is 12 1/s at k = 0.08 s"


def odd_powers(z: Array) -> Float[Array, "3 ..."]:
    """Returns z, z |z| and z^3."""
    return jnp.stack([z, z * jnp.abs(z), z**3])


def even_powers(z: Array) -> Float[Array, "3 ..."]:
    """Returns |z|, z^2 and |z|^3."""
    size = jnp.abs(z)
    return jnp.stack([size, size**2, size**3])


class FlowTerm(Flow):
    """dp/dt changes by a sign times f(z). f is a sum of three basis functions of a state z."""

    a: Scalar = parameter(0.0, -5e6, 5e6, "Pa/s", WHY)
    """Factor of the first basis function."""
    b: Scalar = parameter(0.0, -5e6, 5e6, "Pa/s", WHY)
    """Factor of the second basis function."""
    c: Scalar = parameter(0.0, -5e6, 5e6, "Pa/s", WHY)
    """Factor of the third basis function."""

    @abstractmethod
    def state(self, x: Chamber) -> Array:
        """Returns the state z of the chambers."""

    @abstractmethod
    def basis(self, z: Array) -> Float[Array, "3 ..."]:
        """Returns the basis functions at the state z."""

    @abstractmethod
    def factor(self, x: Chamber) -> Array:
        """Returns the sign with which f changes dp/dt."""

    def rate(self, rate, x):
        values = jnp.stack([self.a, self.b, self.c])
        f = jnp.sum(values[:, None] * self.basis(self.state(x)), axis=0)
        return rate + self.factor(x) * f


class FlowOfPressure(FlowTerm):
    """dp/dt changes by an odd function f of the pressure p."""

    title = "flow that depends on the pressure"
    term_curve = Curve("pressure p", "Pa", "change of dp/dt", "Pa/s")

    def state(self, x):
        return x.p

    def basis(self, z):
        return odd_powers(z / PRESSURE)

    def factor(self, x):
        return jnp.ones_like(x.p)


class FlowOfPressureBySide(FlowTerm):
    """dp/dt changes by an even function f of the pressure p, so the robot's sides differ."""

    title = "flow that depends on the pressure and differs between the sides"
    term_curve = Curve("pressure p", "Pa", "change of dp/dt", "Pa/s")

    def state(self, x):
        return x.p

    def basis(self, z):
        return even_powers(z / PRESSURE)

    def factor(self, x):
        return jnp.ones_like(x.p)


class FlowOfDifference(FlowTerm):
    """dp/dt changes by an odd function f of the difference p_set - p."""

    title = "flow that depends on the pressure difference"
    term_curve = Curve("difference p_set - p", "Pa", "change of dp/dt", "Pa/s")

    def state(self, x):
        return x.p_set - x.p

    def basis(self, z):
        # A linear function would be the lag of the base model, so a square root replaces it.
        e = z / DIFFERENCE
        return jnp.stack([e / jnp.sqrt(magnitude(e, CORNER)), e * jnp.abs(e), e**3])

    def factor(self, x):
        return jnp.ones_like(x.p)


class FlowOfFilling(FlowTerm):
    """d|p|/dt changes by an even function f of p_set - p, so filling and venting differ."""

    title = "flow that differs between filling and venting"
    term_curve = Curve("difference side (p_set - p)", "Pa", "change of side dp/dt", "Pa/s")

    def state(self, x):
        return x.side * (x.p_set - x.p)

    def basis(self, z):
        return even_powers(z / DIFFERENCE)

    def factor(self, x):
        return x.side


class FlowFactor(Flow):
    """1/k changes by a function f of |p|: dp/dt changes by f (p_set - p)."""

    title = "valve whose opening depends on the pressure"
    term_curve = Curve("pressure |p|", "Pa", "change of 1/k", "1/s")

    a: Scalar = parameter(0.0, -20.0, 20.0, "1/s", WHY_FACTOR)
    """Factor of the first basis function."""
    b: Scalar = parameter(0.0, -20.0, 20.0, "1/s", WHY_FACTOR)
    """Factor of the second basis function."""
    c: Scalar = parameter(0.0, -20.0, 20.0, "1/s", WHY_FACTOR)
    """Factor of the third basis function."""

    def state(self, x: Chamber) -> Array:
        """Returns |p| of the chambers."""
        return jnp.abs(x.p)

    def basis(self, z: Array) -> Float[Array, "3 ..."]:
        """Returns the basis functions at the state z."""
        return even_powers(z / PRESSURE)

    def rate(self, rate, x):
        values = jnp.stack([self.a, self.b, self.c])
        f = jnp.sum(values[:, None] * self.basis(self.state(x)), axis=0)
        return rate + f * (x.p_set - x.p)
