"""Terms of the flow into a chamber."""

from abc import abstractmethod
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Chamber, Curve, Flow, parameter

PRESSURES = (75e3, 150e3, 225e3, 300e3)
"""Nodes [Pa] of the piecewise linear functions of the pressure."""
DIFFERENCES = (50e3, 150e3, 300e3, 600e3)
"""Nodes [Pa] of the piecewise linear functions of p_set - p. This difference reaches twice the
amplitude of the drive."""
WHY = "the flow at 250 kPa and k = 0.08 s is 3 MPa/s"
WHY_FACTOR = "1/k is 12 1/s at k = 0.08 s"


def hats(z: Array, nodes: Sequence[float]) -> Float[Array, "nodes ..."]:
    """Returns piecewise linear functions of z >= 0: function i is 1 at node i and 0 at the others.

    All functions are 0 at z = 0. Beyond the last node, the functions are constant.
    """
    edges = np.array([0.0, *nodes]).reshape(-1, *[1] * z.ndim)
    ramps = jnp.clip((z - edges[:-1]) / np.diff(edges, axis=0), 0.0, 1.0)
    return ramps - jnp.concatenate([ramps[1:], jnp.zeros_like(ramps[:1])])


class FlowTerm(Flow):
    """dp/dt changes by a sign times a function f of a local state z. f is piecewise linear."""

    a: Scalar = parameter(0.0, -5e6, 5e6, "Pa/s", WHY)
    """f at the first node."""
    b: Scalar = parameter(0.0, -5e6, 5e6, "Pa/s", WHY)
    """f at the second node."""
    c: Scalar = parameter(0.0, -5e6, 5e6, "Pa/s", WHY)
    """f at the third node."""
    d: Scalar = parameter(0.0, -5e6, 5e6, "Pa/s", WHY)
    """f at the last node and beyond."""

    @abstractmethod
    def state(self, x: Chamber) -> Array:
        """Returns the state z of the chambers."""

    @abstractmethod
    def basis(self, z: Array) -> Float[Array, "4 ..."]:
        """Returns the basis functions at the state z."""

    @abstractmethod
    def factor(self, x: Chamber) -> Array:
        """Returns the sign with which f changes dp/dt."""

    def rate(self, rate, x):
        values = jnp.stack([self.a, self.b, self.c, self.d])
        f = jnp.sum(values[:, None] * self.basis(self.state(x)), axis=0)
        return rate + self.factor(x) * f


class FlowOfPressure(FlowTerm):
    """dp/dt changes by an odd function f of the pressure p."""

    title = "flow that depends on the pressure"
    curve = Curve("pressure p", "Pa", "change of dp/dt", "Pa/s")

    def state(self, x):
        return x.p

    def basis(self, z):
        return jnp.sign(z) * hats(jnp.abs(z), PRESSURES)

    def factor(self, x):
        return jnp.ones_like(x.p)


class FlowOfPressureBySide(FlowTerm):
    """dp/dt changes by an even function f of the pressure p, so both sides differ."""

    title = "flow that depends on the pressure and differs between the sides"
    curve = Curve("pressure p", "Pa", "change of dp/dt", "Pa/s")

    def state(self, x):
        return x.p

    def basis(self, z):
        return hats(jnp.abs(z), PRESSURES)

    def factor(self, x):
        return jnp.ones_like(x.p)


class FlowOfDifference(FlowTerm):
    """dp/dt changes by an odd function f of the difference p_set - p."""

    title = "flow that depends on the pressure difference"
    curve = Curve("difference p_set - p", "Pa", "change of dp/dt", "Pa/s")

    def state(self, x):
        return x.p_set - x.p

    def basis(self, z):
        return jnp.sign(z) * hats(jnp.abs(z), DIFFERENCES)

    def factor(self, x):
        return jnp.ones_like(x.p)


class FlowOfFilling(FlowTerm):
    """d|p|/dt changes by an even function f of p_set - p, so filling and venting differ."""

    title = "flow that differs between filling and venting"
    curve = Curve("difference side (p_set - p)", "Pa", "change of side dp/dt", "Pa/s")

    def state(self, x):
        return x.side * (x.p_set - x.p)

    def basis(self, z):
        return hats(jnp.abs(z), DIFFERENCES)

    def factor(self, x):
        return x.side


class FlowFactor(Flow):
    """The flow per pressure difference changes by a function f of |p|: dp/dt + f (p_set - p)."""

    title = "valve whose opening depends on the pressure"
    curve = Curve("pressure |p|", "Pa", "change of 1/k", "1/s")

    a: Scalar = parameter(0.0, -20.0, 20.0, "1/s", WHY_FACTOR)
    """f at the first node."""
    b: Scalar = parameter(0.0, -20.0, 20.0, "1/s", WHY_FACTOR)
    """f at the second node."""
    c: Scalar = parameter(0.0, -20.0, 20.0, "1/s", WHY_FACTOR)
    """f at the third node."""
    d: Scalar = parameter(0.0, -20.0, 20.0, "1/s", WHY_FACTOR)
    """f at the last node and beyond."""

    def state(self, x: Chamber) -> Array:
        """Returns |p| of the chambers."""
        return jnp.abs(x.p)

    def basis(self, z: Array) -> Float[Array, "4 ..."]:
        """Returns the basis functions at the state z."""
        return hats(z, PRESSURES)

    def rate(self, rate, x):
        values = jnp.stack([self.a, self.b, self.c, self.d])
        f = jnp.sum(values[:, None] * self.basis(self.state(x)), axis=0)
        return rate + f * (x.p_set - x.p)
