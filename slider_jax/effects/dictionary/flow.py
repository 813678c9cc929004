"""Terms of the flow into a chamber."""

from abc import abstractmethod

import jax.numpy as jnp
from jaxtyping import Array

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Chamber, Curve, Flow, Readings, mean_of_others, shape_parameter
from slider_jax.effects.functions import (
    MEMORY_TIMES,
    Basis,
    Powers,
    RigDrift,
    even_powers,
    mixed_powers,
    odd_corners,
    odd_powers,
    signed_root,
)

CORNER = 0.02
"""Width of the smooth corner of the square root, as a fraction of the largest difference."""
DIFFERENCE, RATE, OPENING = 250e3, 3e6, 12.5
"""A typical difference p_set - p [Pa], and with k = 0.08 s, its dp/dt [Pa/s] and 1/k [1/s]. The
parameters of a term are factors of one of the last two."""
MEMORY_TIME = 0.3
"""Time constant [s] of the recent flow: a stride at 3 Hz."""
WHY_SCALE = "the pressures of a soft robot"


class FlowTerm(Powers, Flow):
    """dp/dt changes by a sign times f(z). f is a sum of three basis functions of a state z."""

    @abstractmethod
    def state(self, x: Chamber) -> Array:
        """Returns the state z of the chambers."""

    @abstractmethod
    def basis(self, z: Array) -> Basis:
        """Returns the basis functions at the state z."""

    def factor(self, x: Chamber) -> Array:
        """Returns the sign with which f changes dp/dt, 1 by default."""
        return jnp.ones_like(x.p)

    def rate(self, rate, x):
        return rate + self.factor(x) * self.total(self.basis(self.state(x)))


class RearFlow:
    """The last chamber; only its flow changes."""

    def rate(self, rate, x):
        return jnp.where(x.rear == 1.0, super().rate(rate, x), rate)  # type: ignore[misc]


class PressureTerm(FlowTerm):
    """A term whose function depends on the pressure p."""

    term_curve = Curve("pressure p", "Pa", "change of dp/dt", "Pa/s")

    scale: Scalar = shape_parameter(200e3, 1e3, 2e6, "Pa", WHY_SCALE)
    """State beyond which the function is constant. A learned function uses the 99.5 % quantile of
    the visited |p|."""

    def state(self, x):
        return x.p


class FlowOfPressure(PressureTerm):
    """dp/dt changes by an odd function f of the pressure p."""

    title = "flow that depends on the pressure"

    def basis(self, z):
        return odd_powers(z / self.scale, RATE)


class FlowOfPressureBySide(PressureTerm):
    """dp/dt changes by an even function f of the pressure p, so the robot's sides differ."""

    title = "flow that depends on the pressure and differs between the sides"

    def basis(self, z):
        return even_powers(z / self.scale, RATE)


class FlowOfPressureWithCorners(PressureTerm):
    """dp/dt changes by an odd function f of the pressure p that has corners."""

    title = "flow that depends on the pressure, with corners"

    def basis(self, z):
        return odd_corners(z / self.scale, RATE)


class RearFlowOfPressure(RearFlow, PressureTerm):
    """dp/dt of the last chamber changes by a function f of its pressure p.

    f is a sum of p, |p| and p^2.
    """

    title = "flow into the last chamber that depends on the pressure"

    def basis(self, z):
        return mixed_powers(z / self.scale, RATE)


class DifferenceTerm(FlowTerm):
    """A term whose function depends on the difference p_set - p."""

    scale: Scalar = shape_parameter(300e3, 1e3, 4e6, "Pa", WHY_SCALE)
    """State beyond which the function is constant. A learned function uses the 99.5 % quantile of
    the visited |p_set - p|."""


class OwnDifferenceTerm(DifferenceTerm):
    """A term whose function depends on the chamber's own difference p_set - p."""

    term_curve = Curve("difference p_set - p", "Pa", "change of dp/dt", "Pa/s")

    def state(self, x):
        return x.p_set - x.p


class FlowOfDifference(OwnDifferenceTerm):
    """dp/dt changes by an odd function f of the difference p_set - p."""

    title = "flow that depends on the pressure difference"

    def basis(self, z):
        # A linear function would be the lag of the base model, so a square root replaces it.
        e = jnp.clip(z / self.scale, -1.0, 1.0)
        _, quadratic, cubic = odd_powers(e, RATE)
        return RATE * signed_root(e, CORNER), quadratic, cubic


class FlowOfDifferenceBySide(OwnDifferenceTerm):
    """dp/dt changes by an even function f of the difference p_set - p, so the sides differ."""

    title = "flow that depends on the pressure difference and differs between the sides"

    def basis(self, z):
        return even_powers(z / self.scale, RATE)


class RearFlowOfDifference(RearFlow, OwnDifferenceTerm):
    """dp/dt of the last chamber changes by a function f of its difference p_set - p.

    f is a sum of the difference, its absolute value and its square.
    """

    title = "flow into the last chamber that depends on the pressure difference"

    def basis(self, z):
        return mixed_powers(z / self.scale, RATE)


class FlowOfOtherDifference(DifferenceTerm):
    """dp/dt changes by a function f of the other chambers' mean difference p_set - p.

    f is a sum of the difference, its absolute value and its square.
    """

    title = "flow that depends on the pressure difference of the other chambers"
    term_curve = Curve(
        "difference p_set - p of the other chambers", "Pa", "change of dp/dt", "Pa/s"
    )

    def state(self, x):
        return mean_of_others(x.p_set - x.p)

    def basis(self, z):
        return mixed_powers(z / self.scale, RATE)


class FlowOfDifferenceWithCorners(OwnDifferenceTerm):
    """dp/dt changes by an odd function f of the difference p_set - p that has corners."""

    title = "flow that depends on the pressure difference, with corners"

    def basis(self, z):
        return odd_corners(z / self.scale, RATE)


class FlowOfLaggedDifference(Powers, Flow):
    """dp/dt changes by a sum of three lagged differences z, with the time constants `MEMORY_TIMES`.

        tau dz/dt = p_set - p - z,    z(0) = 0

    One unit of a parameter changes dp/dt by 3 MPa/s at z = 250 kPa. The sum describes a regulator
    with an integral part, and a valve that opens late.
    """

    title = "flow that depends on the lagged pressure difference"
    states = 3
    term_curve = Curve("time t after a step of 250 kPa", "s", "change of dp/dt", "Pa/s")

    def state(self, x: Readings) -> Array:
        """Returns the time [s]."""
        return x.t

    def basis(self, z: Array) -> Basis:
        """Returns the three changes of dp/dt at the time z after a step of 250 kPa."""
        first, second, third = (RATE * (1.0 - jnp.exp(-z / tau)) for tau in MEMORY_TIMES)
        return first, second, third

    def rate(self, rate, x):
        first, second, third = (RATE / DIFFERENCE * z for z in x.states)
        return rate + self.total((first, second, third))

    def state_rates(self, rate, x):
        e = x.p_set - x.p
        return jnp.stack([(e - z) / tau for z, tau in zip(x.states, MEMORY_TIMES, strict=True)])


class FlowBetweenChambers(FlowTerm):
    """dp/dt changes by an odd function f of the difference d of the chambers' pressures.

    d is the pressure of the chamber minus the mean pressure of the other chambers. f is a sum of a
    smooth square root (an orifice), a linear function (a narrow gap) and d |d|.
    """

    title = "flow between the chambers that depends on their pressure difference"
    term_curve = Curve("difference p - p_other", "Pa", "change of dp/dt", "Pa/s")

    scale: Scalar = shape_parameter(300e3, 1e3, 4e6, "Pa", WHY_SCALE)
    """State beyond which the function is constant. A learned function uses the 99.5 % quantile of
    the visited |d|."""

    def state(self, x):
        return x.p - mean_of_others(x.p)

    def basis(self, z):
        q = jnp.clip(z / self.scale, -1.0, 1.0)
        linear, quadratic, _ = odd_powers(q, RATE)
        return RATE * signed_root(q, CORNER), linear, quadratic


class FlowOfFilling(DifferenceTerm):
    """d|p|/dt changes by an even function f of p_set - p, so filling and venting differ."""

    title = "flow that differs between filling and venting"
    term_curve = Curve("difference side (p_set - p)", "Pa", "change of side dp/dt", "Pa/s")

    def state(self, x):
        return x.side * (x.p_set - x.p)

    def basis(self, z):
        return even_powers(z / self.scale, RATE)

    def factor(self, x):
        return x.side


class OpeningTerm(Powers, Flow):
    """1/k changes by a function f of a state z, so dp/dt changes by a part of f (p_set - p)."""

    term_curve = Curve("pressure |p|", "Pa", "change of 1/k", "1/s")

    scale: Scalar = shape_parameter(200e3, 1e3, 2e6, "Pa", WHY_SCALE)
    """State beyond which the function is constant. A learned function uses the 99.5 % quantile of
    the visited |z|."""

    def state(self, x: Chamber) -> Array:
        """Returns the state z of the chambers, |p| by default."""
        return jnp.abs(x.p)

    def basis(self, z: Array) -> Basis:
        """Returns the basis functions at the state z. The parameter k describes a constant f."""
        return even_powers(z / self.scale, OPENING)

    @abstractmethod
    def acts(self, x: Chamber) -> Array:
        """Returns whether f acts in the chambers."""

    def rate(self, rate, x):
        change = self.total(self.basis(self.state(x))) * (x.p_set - x.p)
        return rate + jnp.where(self.acts(x), change, 0.0)


class OfFrontValve:
    """The valves of the first chamber; f acts only there."""

    def acts(self, x: Chamber) -> Array:
        return jnp.asarray(x.rear) == 0.0


class OfRearValve:
    """The valves of the last chamber; f acts only there."""

    def acts(self, x: Chamber) -> Array:
        return jnp.asarray(x.rear) == 1.0


class ValveOpening(OpeningTerm):
    """1/k changes by a function f of |p|."""

    title = "valve whose opening depends on the pressure"

    def acts(self, x):
        return jnp.ones_like(x.filling)


class VentingOpening(OpeningTerm):
    """1/k changes by a function f of |p| while the chamber vents."""

    title = "valve whose opening depends on the pressure while the chamber vents"

    def acts(self, x):
        return ~x.filling


class FillingOpeningOfOther(OpeningTerm):
    """1/k changes by a function f of d while the chamber fills, because both share a supply.

    d is the mean pressure difference that fills the other chambers: side (p_set - p), or 0 for a
    chamber that does not fill.
    """

    title = "valve whose flow depends on the filling of the other chambers"
    term_curve = Curve("difference that fills the other chambers", "Pa", "change of 1/k", "1/s")

    def state(self, x):
        return mean_of_others(jnp.maximum(x.side * (x.p_set - x.p), 0.0))

    def acts(self, x):
        return x.filling


class RearOpening(RearFlow, ValveOpening):
    """1/k of the last chamber changes by a function f of |p|."""

    title = "valve of the last chamber whose opening depends on the pressure"


class OpeningOfSetPressure(OpeningTerm):
    """1/k changes by a function f of the part of |p_set| with the sign of p, which fills."""

    title = "valve whose opening depends on the set pressure"
    term_curve = Curve("set pressure |p_set|", "Pa", "change of 1/k", "1/s")

    def state(self, x):
        return jnp.maximum(x.side * x.p_set, 0.0)

    def acts(self, x):
        return jnp.ones_like(x.filling)


class OpeningOfOther(OpeningTerm):
    """1/k of one chamber changes by a function f of |p_other|, the mean |p| of the others."""

    term_curve = Curve("pressure |p_other|", "Pa", "change of 1/k", "1/s")

    def state(self, x):
        return mean_of_others(jnp.abs(x.p))


class FrontOpeningOfOther(OfFrontValve, OpeningOfOther):
    """1/k of the first chamber changes by a function f of |p_other|."""

    title = "valve of the first chamber whose opening depends on the other chambers' pressure"


class RearOpeningOfOther(OfRearValve, OpeningOfOther):
    """1/k of the last chamber changes by a function f of |p_other|."""

    title = "valve of the last chamber whose opening depends on the other chambers' pressure"


class OpeningOfDifference(OpeningTerm):
    """1/k of one chamber changes by a function f of the difference |p_other| - |p|."""

    term_curve = Curve("difference |p_other| - |p|", "Pa", "change of 1/k", "1/s")

    def state(self, x):
        size = jnp.abs(x.p)
        return mean_of_others(size) - size

    def basis(self, z):
        return mixed_powers(z / self.scale, OPENING)


class FrontOpeningOfDifference(OfFrontValve, OpeningOfDifference):
    """1/k of the first chamber changes by a function f of |p_other| - |p|."""

    title = "valve of the first chamber whose opening depends on the difference of the pressures"


class RearOpeningOfDifference(OfRearValve, OpeningOfDifference):
    """1/k of the last chamber changes by a function f of |p_other| - |p|."""

    title = "valve of the last chamber whose opening depends on the difference of the pressures"


class OpeningDrift(RigDrift, Flow):
    """1/k of all chambers changes by a function of the time t. The state of a chamber is t."""

    title = "valves whose opening drifts during a trial"
    states = 1
    term_curve = Curve("time t", "s", "change of 1/k divided by 12.5 1/s", "-")

    def rate(self, rate, x):
        return rate + OPENING * self.at(x.states[0]) * (x.p_set - x.p)

    def state_rates(self, rate, x):
        return jnp.ones_like(x.states)


class RearOpeningDrift(RearFlow, OpeningDrift):
    """1/k of the last chamber changes by a function of the time t."""

    title = "valve of the last chamber whose opening drifts during a trial"


class OpeningOfSum(OpeningTerm):
    """1/k of one chamber changes by an even function f of the sum of the pressures."""

    term_curve = Curve("sum |p + p_other|", "Pa", "change of 1/k", "1/s")

    def state(self, x):
        return jnp.abs(x.p + mean_of_others(x.p))


class FrontOpeningOfSum(OfFrontValve, OpeningOfSum):
    """1/k of the first chamber changes by a function f of |p + p_other|."""

    title = "valve of the first chamber whose opening depends on the sum of the pressures"


class RearOpeningOfSum(OfRearValve, OpeningOfSum):
    """1/k of the last chamber changes by a function f of |p + p_other|."""

    title = "valve of the last chamber whose opening depends on the sum of the pressures"


class OpeningOfRecentFlow(OpeningTerm):
    """1/k changes by a function f of the recent flow r.

        0.3 s dr/dt = |q| k - r

    q is dp/dt without the effect. The curve and the scale of a learned function use |p_set - p|
    instead of r. r is hardly ever larger than the largest |p_set - p|.
    """

    states = 1
    term_curve = Curve("recent mean of |dp/dt| k", "Pa", "change of 1/k", "1/s")

    def state(self, x):
        return jnp.abs(x.p_set - x.p)

    def rate(self, rate, x):
        change = self.total(self.basis(x.states[0])) * (x.p_set - x.p)
        return rate + jnp.where(self.acts(x), change, 0.0)

    def state_rates(self, rate, x):
        return ((jnp.abs(rate) * x.k - x.states[0]) / MEMORY_TIME)[None]


class FillingOpeningOfRecentFlow(OpeningOfRecentFlow):
    """1/k changes by a function f of the recent flow while the chamber fills."""

    title = "valve whose opening depends on the recent flow while the chamber fills"

    def acts(self, x):
        return x.filling


class VentingOpeningOfRecentFlow(OpeningOfRecentFlow):
    """1/k changes by a function f of the recent flow while the chamber vents."""

    title = "valve whose opening depends on the recent flow while the chamber vents"

    def acts(self, x):
        return ~x.filling
