"""Terms of the bending moment in body and tail."""

from abc import abstractmethod

import jax.numpy as jnp
from jaxtyping import Array

from slider_jax.beam.equations import Section
from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BendingMoment, Curve, parameter, shape_parameter
from slider_jax.effects.functions import Basis, PartPowers, even_powers, magnitude, odd_powers

CURVATURE, RATE, MOMENT = 3.0, 60.0, 0.05
"""Curvature [1/m], rate of the curvature [1/(m s)] and moment [N m] in a typical stride at 5 Hz.
The parameter of a term of the rate is the term's M/EI at the rate `RATE`."""
CORNER = 0.1
"""Width of the smooth corner, as a fraction of `RATE` or of the scale of the curvature."""
WHY = "the elastic moment divided by EI is 3 1/m at kappa = 3 1/m"
OF_KAPPA = Curve("curvature kappa", "1/m", "moment M/EI", "1/m")
OF_RATE = Curve("rate of curvature d(kappa)/dt", "1/(m s)", "moment M/EI", "1/m")


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


class CurvatureTerm(PartPowers, BendingMoment):
    """M/EI is a function of the curvature kappa in one part of the robot."""

    term_curve = OF_KAPPA

    scale: Scalar = shape_parameter(CURVATURE, 1e-2, 1e3, "1/m", "the curvatures of a soft robot")
    """State beyond which the function is constant. A learned function uses the 99.5 % quantile of
    the visited |kappa|."""

    def state(self, x: Section) -> Array:
        """Returns the curvature in each cell."""
        return x.kappa

    @abstractmethod
    def basis(self, z: Array) -> Basis:
        """Returns the basis functions at the curvature z."""

    def moment(self, x, memory, dt):
        return x.EI * self.cells(x) * self.total(self.basis(self.state(x))), memory


class MomentOfBody(CurvatureTerm):
    """M/EI is an odd function of the curvature kappa in the body."""

    title = "moment of the body that depends on the curvature"
    segments = ("body",)

    def basis(self, z):
        return odd_powers(z / self.scale, self.scale)


class MomentOfTail(CurvatureTerm):
    """M/EI is an odd function of the curvature kappa in the tail."""

    title = "moment of the tail that depends on the curvature"
    segments, part = ("tail",), "tail"

    def basis(self, z):
        return odd_powers(z / self.scale, self.scale)


class MomentOfBodyBySide(CurvatureTerm):
    """M/EI is an even function of the curvature kappa in the body, so the robot's sides differ."""

    title = "moment of the body that depends on the curvature and differs between the sides"
    segments = ("body",)

    def basis(self, z):
        return even_powers(z / self.scale, self.scale)


class MomentOfTailBySide(CurvatureTerm):
    """M/EI is an even function of the curvature kappa in the tail, so the robot's sides differ."""

    title = "moment of the tail that depends on the curvature and differs between the sides"
    segments, part = ("tail",), "tail"

    def basis(self, z):
        return even_powers(z / self.scale, self.scale)


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


class MomentOfRateBySide(MomentTerm):
    """M = EI a |r|, with the rate of curvature r in units of `RATE`."""

    title = "moment of the rate of curvature that differs between the directions of bending"
    term_curve = OF_RATE

    def state(self, x):
        return x.kappa_t

    def basis(self, z):
        return magnitude(z / RATE, CORNER) - CORNER


class MomentOfStraightening(MomentTerm):
    """M = EI a |r| sign(kappa): the damping differs while |kappa| grows and while it decreases.

    r is the rate of curvature in units of `RATE`. The corners of |r| and of the sign are smooth.
    """

    title = "damping that differs between bending and straightening"
    term_curve = Curve("rate of curvature, at kappa > 0", "1/(m s)", "moment M/EI", "1/m")

    def state(self, x):
        return x.kappa_t

    def basis(self, z):
        return magnitude(z / RATE, CORNER) - CORNER

    def moment(self, x, memory, dt):
        moment, memory = super().moment(x, memory, dt)
        q = x.kappa / CURVATURE
        return moment * q / magnitude(q, CORNER), memory


class DampingTerm(PartPowers, BendingMoment):
    """M = EI f(kappa) d(kappa)/dt in one part of the robot."""

    term_curve = Curve("curvature kappa", "1/m", "damping time", "s")

    scale: Scalar = shape_parameter(CURVATURE, 1e-2, 1e3, "1/m", "the curvatures of a soft robot")
    """State beyond which the function is constant. A learned function uses the 99.5 % quantile of
    the visited |kappa|."""

    def state(self, x: Section) -> Array:
        """Returns the curvature in each cell."""
        return x.kappa

    @abstractmethod
    def basis(self, z: Array) -> Basis:
        """Returns the basis functions at the curvature z."""

    def dampings(self, z: Array) -> Basis:
        """Returns smooth functions of the curvature z: its sign, z and |z|.

        The term `moment_of_rate` describes a constant f.
        """
        q = jnp.clip(z / self.scale, -1.0, 1.0)
        size, factor = magnitude(q, CORNER), CURVATURE / RATE
        return factor * q / size, factor * q, factor * size

    def moment(self, x, memory, dt):
        damping = x.EI * self.cells(x) * self.total(self.basis(self.state(x)))
        return damping * x.kappa_t, memory


class DampingOfBody(DampingTerm):
    """The damping of the body is a function of its curvature."""

    title = "damping of the body that depends on the curvature"
    segments = ("body",)

    def basis(self, z):
        return self.dampings(z)


class DampingOfTail(DampingTerm):
    """The damping of the tail is a function of its curvature."""

    title = "damping of the tail that depends on the curvature"
    segments, part = ("tail",), "tail"

    def basis(self, z):
        return self.dampings(z)


class PressureMomentTerm(PartPowers, BendingMoment):
    """M is a function of the pressure of the chamber."""

    segments = ("body",)
    term_curve = Curve("pressure of the chamber", "Pa", "moment M", "N m")

    scale: Scalar = shape_parameter(200e3, 1e3, 2e6, "Pa", "the pressures of a soft robot")
    """State beyond which the function is constant. A learned function uses the 99.5 % quantile of
    the visited |p|."""

    def state(self, x: Section) -> Array:
        """Returns the pressure [Pa] of the chamber at each cell."""
        return x.pressure

    @abstractmethod
    def basis(self, z: Array) -> Basis:
        """Returns the basis functions at the pressure z [Pa]."""

    def moment(self, x, memory, dt):
        return self.cells(x) * self.total(self.basis(self.state(x))), memory


class MomentOfPressure(PressureMomentTerm):
    """M is an odd function of the pressure."""

    title = "bending moment that depends on the pressure"

    def basis(self, z):
        # The parameter K_Q describes a moment that is linear in z, so z^5 replaces z.
        q = jnp.clip(z / self.scale, -1.0, 1.0)
        return MOMENT * q * jnp.abs(q), MOMENT * q**3, MOMENT * q**5


class MomentOfPressureBySide(PressureMomentTerm):
    """M is an even function of the pressure, so the robot's sides differ."""

    title = "bending moment that depends on the pressure and differs between the sides"

    def basis(self, z):
        return even_powers(z / self.scale, MOMENT)
