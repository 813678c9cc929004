"""Terms of the bending moment in body and tail."""

from abc import abstractmethod

import jax.numpy as jnp
from jaxtyping import Array

from slider_jax.beam.equations import Section
from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BendingMoment, Curve, parameter, shape_parameter
from slider_jax.effects.body.internal_friction import dahl_state
from slider_jax.effects.functions import (
    Basis,
    ChamberPowers,
    LocalDrift,
    PartPowers,
    even_corners,
    even_powers,
    magnitude,
    mixed_powers,
    odd_corners,
    odd_powers,
    rises,
    signed_root,
    waves,
)

CURVATURE, RATE, MOMENT = 3.0, 60.0, 0.05
"""Curvature [1/m], rate of the curvature [1/(m s)] and moment [N m] in a typical stride at 5 Hz.
The parameter of a term of the rate is the term's M/EI at the rate `RATE`."""
CORNER = 0.1
"""Width of the smooth corner, as a fraction of `RATE` or of the scale of the curvature."""
ROOT_CORNER = 0.02
"""Width of the smooth corner of the square root, as a fraction of `RATE`. The slope at the rate 0
is then 7/`RATE`, less than the slope of dry friction."""
MEMORY_TIME = 0.3
"""Time constant [s] of the recent mean square of the curvature: a stride at 3 Hz."""
REST = 1e-6
"""Recent rms of the curvature [1/m] of a robot at rest, because a square root has no derivative
at 0."""
FRICTION_CURVATURE = 0.3
"""Change of the curvature [1/m] in which dry friction builds up: a tenth of `CURVATURE`."""
FULL_PRESSURE = 200e3
"""Typical pressure [Pa]. With it, `MOMENT` is the moment of a chamber."""
WHY = "the elastic moment divided by EI is 3 1/m at kappa = 3 1/m"


class RateTerm(BendingMoment):
    """A moment that depends on the rate of curvature r, with one factor for each part.

    r is in units of `RATE`.
    """

    segments = ("body", "tail")

    body: Scalar = parameter(0.0, -5.0, 5.0, "1/m", WHY)
    """Factor in the body."""
    tail: Scalar = parameter(0.0, -5.0, 5.0, "1/m", WHY)
    """Factor in the tail."""

    def state(self, x: Section) -> Array:
        """Returns the rate of curvature in each cell."""
        return x.kappa_t

    @abstractmethod
    def basis(self, z: Array) -> Array:
        """Returns the function at the rate of curvature z for a factor of 1."""

    def of_rate(self, x: Section) -> Array:
        """Returns EI times the factor of the part times the function of the rate."""
        factor = self.body + (self.tail - self.body) * x.in_tail
        return x.EI * factor * self.basis(self.state(x))


class MomentOfRateTerm(RateTerm):
    """M/EI is a function of the rate of curvature."""

    term_curve = Curve("rate of curvature d(kappa)/dt", "1/(m s)", "moment M/EI", "1/m")

    def moment(self, x, memory, dt):
        return self.of_rate(x), memory


def size_of_rate(z: Array) -> Array:
    """Returns |z| in units of `RATE` with a smooth corner; the result is 0 at z = 0."""
    return magnitude(z / RATE, CORNER) - CORNER


class CurvatureTerm(PartPowers, BendingMoment):
    """A moment that depends on a function of the curvature kappa in one part of the robot."""

    scale: Scalar = shape_parameter(CURVATURE, 1e-2, 1e3, "1/m", "the curvatures of a soft robot")
    """State beyond which the function is constant. A learned function uses the 99.5 % quantile of
    the visited |kappa|."""

    def state(self, x: Section) -> Array:
        """Returns the curvature in each cell."""
        return x.kappa

    @abstractmethod
    def basis(self, z: Array) -> Basis:
        """Returns the basis functions at the curvature z."""

    def of_curvature(self, x: Section) -> Array:
        """Returns EI times the function of the curvature in the part, and 0 elsewhere."""
        return x.EI * self.cells(x) * self.total(self.basis(self.state(x)))


class MomentOfCurvatureTerm(CurvatureTerm):
    """M/EI is a function of the curvature."""

    term_curve = Curve("curvature kappa", "1/m", "moment M/EI", "1/m")

    def moment(self, x, memory, dt):
        return self.of_curvature(x), memory


class MomentOfBody(MomentOfCurvatureTerm):
    """M/EI is an odd function of the curvature kappa in the body."""

    title = "moment of the body that depends on the curvature"
    segments = ("body",)

    def basis(self, z):
        return odd_powers(z / self.scale, self.scale)


class MomentOfTail(MomentOfCurvatureTerm):
    """M/EI is an odd function of the curvature kappa in the tail."""

    title = "moment of the tail that depends on the curvature"
    segments, part = ("tail",), "tail"

    def basis(self, z):
        return odd_powers(z / self.scale, self.scale)


class MomentOfBodyWithCorners(MomentOfCurvatureTerm):
    """M/EI is an odd function of the curvature kappa in the body that has corners."""

    title = "moment of the body that depends on the curvature, with corners"
    segments = ("body",)

    def basis(self, z):
        return odd_corners(z / self.scale, self.scale)


class MomentOfTailWithCorners(MomentOfCurvatureTerm):
    """M/EI is an odd function of the curvature kappa in the tail that has corners."""

    title = "moment of the tail that depends on the curvature, with corners"
    segments, part = ("tail",), "tail"

    def basis(self, z):
        return odd_corners(z / self.scale, self.scale)


class MomentOfBodyBySide(MomentOfCurvatureTerm):
    """M/EI is an even function of the curvature kappa in the body, so the robot's sides differ."""

    title = "moment of the body that depends on the curvature and differs between the sides"
    segments = ("body",)

    def basis(self, z):
        return even_powers(z / self.scale, self.scale)


class MomentOfBodyBySideWithCorners(MomentOfCurvatureTerm):
    """M/EI is an even function of the curvature kappa in the body that has corners.

    With an odd function, it describes a part that carries load on one side beyond a curvature.
    """

    title = "moment of the body that differs between the sides, with corners"
    segments = ("body",)

    def basis(self, z):
        return even_corners(z / self.scale, self.scale)


class MomentOfTailBySide(MomentOfCurvatureTerm):
    """M/EI is an even function of the curvature kappa in the tail, so the robot's sides differ."""

    title = "moment of the tail that depends on the curvature and differs between the sides"
    segments, part = ("tail",), "tail"

    def basis(self, z):
        return even_powers(z / self.scale, self.scale)


class MomentOfRate(MomentOfRateTerm):
    """M = EI a r, with the rate of curvature r in units of `RATE`."""

    title = "moment linear in the rate of curvature"

    def basis(self, z):
        return z / RATE


class MomentOfRateQuadratic(MomentOfRateTerm):
    """M = EI a r |r|, with the rate of curvature r in units of `RATE`."""

    title = "moment quadratic in the rate of curvature"

    def basis(self, z):
        return z * jnp.abs(z) / RATE**2


class MomentOfRateRoot(MomentOfRateTerm):
    """M = EI a r/(r^2 + w^2)^(1/4) with w = 0.02 and the rate r in units of `RATE`."""

    title = "moment of the square root of the rate of curvature"

    def basis(self, z):
        return signed_root(z / RATE, ROOT_CORNER)


class MomentOfRateSaturated(MomentOfRateTerm):
    """M = EI a r/(r^2 + w^2)^(1/2) with w = 0.1 and the rate r in units of `RATE`: dry friction."""

    title = "moment of dry friction"

    def basis(self, z):
        return z / RATE / magnitude(z / RATE, CORNER)


class MomentOfRateBySide(MomentOfRateTerm):
    """M = EI a |r|, with the factor a of the part and a smooth corner of |r|."""

    title = "moment of the rate of curvature that differs between the directions of bending"

    def basis(self, z):
        return size_of_rate(z)


class MomentOfStraightening(RateTerm):
    """M = EI a |r| sign(kappa): the damping differs while |kappa| grows and while it decreases.

    a is the factor of the part. The corners of |r| and of the sign are smooth.
    """

    title = "damping that differs between bending and straightening"
    term_curve = Curve("rate of curvature, at large kappa > 0", "1/(m s)", "moment M/EI", "1/m")

    def basis(self, z):
        return size_of_rate(z)

    def moment(self, x, memory, dt):
        q = x.kappa / CURVATURE
        return self.of_rate(x) * q / magnitude(q, CORNER), memory


class DampingTerm(CurvatureTerm):
    """M = EI f(kappa) d(kappa)/dt in one part of the robot."""

    term_curve = Curve("curvature kappa", "1/m", "damping time", "s")

    def dampings(self, z: Array) -> Basis:
        """Returns smooth functions of the curvature z: its sign, z and |z|.

        The term `moment_of_rate` describes a constant f.
        """
        return rises(z / self.scale, CORNER, CURVATURE / RATE)

    def moment(self, x, memory, dt):
        return self.of_curvature(x) * x.kappa_t, memory


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


class DampingOfBentBody(DampingTerm):
    """The damping of the body is an even function of its curvature."""

    title = "damping of the body that depends on the size of the curvature"
    segments = ("body",)

    def basis(self, z):
        return even_powers(z / self.scale, CURVATURE / RATE)


class DampingOfBentTail(DampingTerm):
    """The damping of the tail is an even function of its curvature."""

    title = "damping of the tail that depends on the size of the curvature"
    segments, part = ("tail",), "tail"

    def basis(self, z):
        return even_powers(z / self.scale, CURVATURE / RATE)


class ChamberTerm(ChamberPowers, BendingMoment):
    """A moment that depends on a function of the pressure of the chamber."""

    segments = ("body",)


class PressureMomentTerm(ChamberTerm):
    """M is a function of the pressure."""

    term_curve = Curve("pressure of the chamber", "Pa", "moment M", "N m")

    def moment(self, x, memory, dt):
        return self.of_pressure(x), memory


class MomentOfPressure(PressureMomentTerm):
    """M is an odd function of the pressure."""

    title = "bending moment that depends on the pressure"

    def basis(self, z):
        # The parameter K_Q describes a moment that is linear in z, so z^5 replaces z.
        q = jnp.clip(z / self.scale, -1.0, 1.0)
        return MOMENT * q * jnp.abs(q), MOMENT * q**3, MOMENT * q**5


class MomentOfPressureWithCorners(PressureMomentTerm):
    """M is an odd function of the pressure that has corners."""

    title = "bending moment that depends on the pressure, with corners"

    def basis(self, z):
        return odd_corners(z / self.scale, MOMENT)


class MomentOfPressureBySide(PressureMomentTerm):
    """M is an even function of the pressure, so the robot's sides differ."""

    title = "bending moment that depends on the pressure and differs between the sides"

    def basis(self, z):
        return even_powers(z / self.scale, MOMENT)


class DampingOfPressure(ChamberTerm):
    """M = EI f(p) d(kappa)/dt in the body, with the pressure p of the chamber.

    f is a sum of p, |p| and p^2. The term `moment_of_rate` describes a constant f.
    """

    title = "damping of the body that depends on the pressure"
    term_curve = Curve("pressure of the chamber", "Pa", "damping time", "s")

    def basis(self, z):
        return mixed_powers(z / self.scale, CURVATURE / RATE)

    def moment(self, x, memory, dt):
        return x.EI * self.of_pressure(x) * x.kappa_t, memory


class StiffnessOfPressure(ChamberTerm):
    """M = EI f(p) kappa in the body, with the pressure p of the chamber.

    f is a sum of p, |p| and p^2.
    """

    title = "stiffness of the body that depends on the pressure"
    term_curve = Curve("pressure of the chamber", "Pa", "change of the stiffness/EI", "-")

    def basis(self, z):
        return mixed_powers(z / self.scale)

    def moment(self, x, memory, dt):
        return x.EI * self.of_pressure(x) * x.kappa, memory


class MomentOfPressureAndCurvature(CurvatureTerm):
    """M = c p/(200 kPa) f(kappa) in the body, with c = 0.05 N m and the pressure p of the chamber.

    f is a sum of kappa, |kappa| and kappa^2.
    """

    title = "moment of the chambers that depends on the curvature"
    segments = ("body",)
    term_curve = Curve("curvature kappa", "1/m", "change of the moment at 200 kPa/(0.05 N m)", "-")

    def basis(self, z):
        return mixed_powers(z / self.scale)

    def moment(self, x, memory, dt):
        f = self.cells(x) * self.total(self.basis(self.state(x)))
        return MOMENT * x.pressure / FULL_PRESSURE * f, memory


class MomentAlongTerm(PartPowers, BendingMoment):
    """A moment that is multiplied by a function f of the position s along the robot."""

    part = "robot"
    scale: Scalar = shape_parameter(0.4, 1e-2, 100.0, "m", "the lengths of soft robots")
    """Length of the robot. A learned function uses the 99.5 % quantile of s."""

    def state(self, x: Section) -> Array:
        """Returns the position of each cell."""
        return x.s

    def basis(self, z: Array) -> Basis:
        """Returns the basis functions at the position z. Base parameters describe a constant f."""
        return waves(z / self.scale)

    def along(self, x: Section) -> Array:
        """Returns f in the part, and 0 elsewhere."""
        return self.cells(x) * self.total(self.basis(self.state(x)))


class StiffnessAlongRobot(MomentAlongTerm):
    """M = EI f(s) kappa, with the position s along the robot."""

    title = "stiffness that varies along the robot"
    segments = ("body", "tail")
    term_curve = Curve("position s", "m", "change of the stiffness/EI", "-")

    def moment(self, x, memory, dt):
        return x.EI * self.along(x) * x.kappa, memory


class DampingAlongRobot(MomentAlongTerm):
    """M = EI c f(s) d(kappa)/dt, with c = 0.05 s and the position s along the robot."""

    title = "damping that varies along the robot"
    segments = ("body", "tail")
    term_curve = Curve("position s", "m", "change of the damping time divided by 0.05 s", "-")

    def moment(self, x, memory, dt):
        return x.EI * CURVATURE / RATE * self.along(x) * x.kappa_t, memory


class MomentAlongBody(MomentAlongTerm):
    """M = c p/(200 kPa) f(s) in the body, with c = 0.05 N m and the position s along the robot.

    p is the pressure of the chamber.
    """

    title = "moment of the chambers that varies along the body"
    segments, part = ("body",), "body"
    term_curve = Curve("position s", "m", "change of the moment at 200 kPa/(0.05 N m)", "-")

    def moment(self, x, memory, dt):
        return MOMENT * x.pressure / FULL_PRESSURE * self.along(x), memory


class FrictionOfPressure(ChamberTerm):
    """M = f(|p|) q in the body, with the pressure p of the chamber and the state q of dry friction.

        0.3/m dq/dt = d(kappa)/dt - |d(kappa)/dt| q

    f is a sum of |p|, p^2 and |p|^3. Source: Dahl's model, see `internal_friction`.
    """

    title = "dry friction of the body that depends on the pressure"
    term_curve = Curve("pressure of the chamber", "Pa", "moment of friction", "N m")

    def basis(self, z):
        return even_powers(z / self.scale, MOMENT)

    def moment(self, x, memory, dt):
        q = dahl_state(memory, x.kappa_t, dt, FRICTION_CURVATURE)
        return self.of_pressure(x) * q, q


class FrictionOfCurvature(CurvatureTerm):
    """M = EI f(|kappa|) q in the body, with the state q of dry friction of `FrictionOfPressure`.

    f is a sum of |kappa|, kappa^2 and |kappa|^3.
    """

    title = "dry friction of the body that depends on the curvature"
    segments = ("body",)
    term_curve = Curve("curvature kappa", "1/m", "moment of friction M/EI", "1/m")

    def basis(self, z):
        return even_powers(z / self.scale, self.scale)

    def moment(self, x, memory, dt):
        q = dahl_state(memory, x.kappa_t, dt, FRICTION_CURVATURE)
        return self.of_curvature(x) * q, q


class StiffnessOfRecentBending(CurvatureTerm):
    """M = EI f(r) kappa in the body, with the recent rms r of the curvature.

        0.3 s d(r^2)/dt = kappa^2 - r^2

    f is a sum of r^2, r^4 and r^6. The stiffness changes while the robot bends, and recovers while
    the robot is at rest. The curve and the scale of a learned function use |kappa| instead of r. r
    is never larger than the largest |kappa|.
    """

    title = "stiffness of the body that depends on the recent bending"
    segments = ("body",)
    term_curve = Curve("recent rms of the curvature", "1/m", "change of the stiffness/EI", "-")

    def state(self, x):
        return jnp.abs(x.kappa)

    def basis(self, z):
        q = jnp.minimum(jnp.square(z / self.scale), 1.0)
        return q, q**2, q**3

    def moment(self, x, memory, dt):
        gain = dt / MEMORY_TIME
        square = (memory + gain * jnp.square(x.kappa)) / (1.0 + gain)
        recent = jnp.sqrt(square + REST**2)
        return x.EI * self.cells(x) * self.total(self.basis(recent)) * x.kappa, square


class MomentDrift(LocalDrift, BendingMoment):
    """M = M_0 f(t) p/(200 kPa) in the body, with M_0 = 0.05 N m and the chamber's pressure p."""

    title = "moment of the chambers that drifts during a trial"
    segments = ("body",)
    term_curve = Curve("time t", "s", "change of the moment at 200 kPa divided by 0.05 N m", "-")

    def moment(self, x, memory, dt):
        return MOMENT * x.pressure / FULL_PRESSURE * self.in_cells(x), memory


class StiffnessDrift(LocalDrift, BendingMoment):
    """M = EI f(t) kappa in the body."""

    title = "stiffness of the body that drifts during a trial"
    segments = ("body",)
    term_curve = Curve("time t", "s", "change of the stiffness divided by EI", "-")

    def moment(self, x, memory, dt):
        return x.EI * self.in_cells(x) * x.kappa, memory


class DampingDrift(LocalDrift, BendingMoment):
    """M = EI tau f(t) d(kappa)/dt in the body, with tau = 0.05 s."""

    title = "damping of the body that drifts during a trial"
    segments = ("body",)
    term_curve = Curve("time t", "s", "change of the damping time divided by 0.05 s", "-")

    def moment(self, x, memory, dt):
        return x.EI * CURVATURE / RATE * self.in_cells(x) * x.kappa_t, memory
