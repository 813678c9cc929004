"""Terms of the bending moment in body and tail."""

from abc import abstractmethod

import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.equations import Section
from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BendingMoment, Curve, parameter
from slider_jax.effects.functions import magnitude

CURVATURE, RATE, PRESSURE = 3.0, 60.0, 100e3
"""Curvature [1/m], rate of the curvature [1/(m s)] and pressure [Pa] in a typical stride at 5 Hz.
The parameter of a term is the moment at the term's value of these three."""
CORNER = 0.1
"""Width of the smooth corner of a one-sided function, in typical curvatures or pressures."""
WHY = "the elastic moment divided by EI is 3 1/m at kappa = 3 1/m"
WHY_PRESSURE = "100 kPa cause a moment of 0.046 N m with K_Q = 4.6e-7 m^3"
OF_KAPPA = Curve("curvature kappa", "1/m", "moment M/EI", "1/m")
OF_RATE = Curve("rate of curvature d(kappa)/dt", "1/(m s)", "moment M/EI", "1/m")


def one_sided(z: Array) -> Array:
    """Returns max(z, 0) with a smooth corner of the width `CORNER`."""
    return 0.5 * (z + magnitude(z, CORNER) - CORNER)


class MomentTerm(BendingMoment):
    """A moment M/EI that is a function of a local state z, with one factor for each part."""

    segments = ("body", "tail")

    body: Scalar = parameter(0.0, -5.0, 5.0, "1/m", WHY)
    """Factor in the body."""
    tail: Scalar = parameter(0.0, -5.0, 5.0, "1/m", WHY)
    """Factor in the tail."""

    @abstractmethod
    def state(self, x: Section) -> Array:
        """Returns the state z in each cell."""

    @abstractmethod
    def basis(self, z: Array) -> Array:
        """Returns the function at the state z for a factor of 1."""

    def moment(self, x, memory, dt):
        factor = self.body + (self.tail - self.body) * x.in_tail
        return x.EI * factor * self.basis(self.state(x)), memory


class MomentLinear(MomentTerm):
    """M = EI a k, with the curvature k in units of `CURVATURE`."""

    title = "moment linear in the curvature"
    term_curve = OF_KAPPA

    def state(self, x):
        return x.kappa

    def basis(self, z):
        return z / CURVATURE


class MomentQuadratic(MomentTerm):
    """M = EI a k |k|, with the curvature k in units of `CURVATURE`."""

    title = "moment quadratic in the curvature"
    term_curve = OF_KAPPA

    def state(self, x):
        return x.kappa

    def basis(self, z):
        return z * jnp.abs(z) / CURVATURE**2


class MomentCubic(MomentTerm):
    """M = EI a k^3, with the curvature k in units of `CURVATURE`."""

    title = "moment cubic in the curvature"
    term_curve = OF_KAPPA

    def state(self, x):
        return x.kappa

    def basis(self, z):
        return (z / CURVATURE) ** 3


class MomentOneSided(MomentTerm):
    """M = EI a max(k, 0), with the curvature k in units of `CURVATURE`."""

    title = "moment on one side"
    term_curve = OF_KAPPA

    def state(self, x):
        return x.kappa

    def basis(self, z):
        return one_sided(z / CURVATURE)


class MomentOfRate(MomentTerm):
    """M = EI a r, with the rate of curvature r in units of `RATE`."""

    title = "moment linear in the rate of curvature"
    term_curve = OF_RATE

    def state(self, x):
        return x.kappa_t

    def basis(self, z):
        return z / RATE


class MomentOfRateQuadratic(MomentTerm):
    """M = EI a r |r|, with the rate of curvature r in units of `RATE`."""

    title = "moment quadratic in the rate of curvature"
    term_curve = OF_RATE

    def state(self, x):
        return x.kappa_t

    def basis(self, z):
        return z * jnp.abs(z) / RATE**2


class MomentOfRateSaturated(MomentTerm):
    """M = EI a r/(r^2 + w^2)^(1/2) with w = 0.1 and the rate r in units of `RATE`: dry friction."""

    title = "moment of dry friction"
    term_curve = OF_RATE

    def state(self, x):
        return x.kappa_t

    def basis(self, z):
        return z / RATE / magnitude(z / RATE, CORNER)


class MomentOfPressure(BendingMoment):
    """M = a |q| + b q |q| + c q^3, with the pressure q of the chamber in units of `PRESSURE`."""

    title = "bending moment nonlinear in the pressure"
    segments = ("body",)
    term_curve = Curve("pressure of the chamber", "Pa", "moment M", "N m")

    a: Scalar = parameter(0.0, -0.05, 0.05, "N m", WHY_PRESSURE)
    """a, part of M with the same sign for both signs of the pressure."""
    b: Scalar = parameter(0.0, -0.05, 0.05, "N m", WHY_PRESSURE)
    """b, quadratic part."""
    c: Scalar = parameter(0.0, -0.05, 0.05, "N m", WHY_PRESSURE)
    """c, cubic part."""

    def state(self, x: Section) -> Array:
        """Returns the pressure [Pa] of the chamber at each cell."""
        return x.pressure

    def basis(self, z: Array) -> Float[Array, "3 ..."]:
        """Returns the basis functions at the pressure z [Pa]."""
        q = z / PRESSURE
        return jnp.stack([magnitude(q, CORNER) - CORNER, q * jnp.abs(q), q**3])

    def moment(self, x, memory, dt):
        a, b, c = self.basis(self.state(x))
        return self.a * a + self.b * b + self.c * c, memory
