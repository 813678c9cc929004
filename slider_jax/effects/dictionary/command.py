"""Terms of the set pressure at the valves."""

from abc import abstractmethod

import jax.numpy as jnp
from jaxtyping import Array

from slider_jax.actuation.waveform import Segment, Shaped, Waveform
from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Chamber, Command, Curve, shape_parameter
from slider_jax.effects.dictionary.flow import WHY_SCALE
from slider_jax.effects.functions import (
    Basis,
    CubicDrift,
    Powers,
    even_powers,
    mixed_powers,
    odd_corners,
    odd_powers,
)

DELAY = 2e-3
"""Delay [s] that one unit of a delay's parameters causes. The largest parameters add 40 ms."""
GAIN = 0.1
"""Relative change of the set pressure that one unit of a gain's parameters causes."""
PRESSURE = 20e3
"""Pressure [Pa] that one unit of a term's parameters adds: a tenth of a typical pressure."""
ITERATIONS = 3
"""Fixed-point iterations for the time of an edge. Each multiplies the error by the rate of the
delay, which is about 0.01."""


class RearCommand:
    """The rear chamber; only its set pressure changes."""

    def command(self, wave, chamber):
        return super().command(wave, chamber) if chamber else wave  # type: ignore[misc]


class Drifting(Waveform):
    """`wave` at the times t - d(t), with a delay d that changes slowly."""

    wave: Waveform
    drift: CubicDrift

    def _delay(self, t: Array) -> Array:
        return DELAY * self.drift.at(t)

    def segment(self, t0, t1):
        x = self.wave.segment(t0 - self._delay(t0), t1 - self._delay(t1))
        t = x.t_break
        for _ in range(ITERATIONS):  # the time t at which t - d(t) is x.t_break
            t = x.t_break + self._delay(t)
        # Rounding must not move the break of a segment without an edge to before its end. The edge
        # at the start of a step is not limited to t0, because a limit would halve its derivative.
        t = jnp.where(x.t_break >= x.t1, t1, jnp.minimum(t, t1))
        return Segment(t0, t, t1, x.a0, x.a1, x.b0, x.b1)


class SetPressureDelayDrift(CubicDrift, Command):
    """p_set,valve(t) = p_set(t - d(t)), with a delay d that is a function of the time t."""

    title = "delay of the set pressure that drifts during a trial"
    term_curve = Curve("time t", "s", "delay divided by 2 ms", "-")

    def command(self, wave, chamber):
        return Drifting(wave, self)


class Scaled(Waveform):
    """`wave` times a gain that changes slowly.

    If `wave` is piecewise constant, the error of a segment is of second order in the step.
    """

    wave: Waveform
    drift: CubicDrift

    def segment(self, t0, t1):
        x = self.wave.segment(t0, t1)
        start, middle, end = (1.0 + GAIN * self.drift.at(t) for t in (x.t0, x.t_break, x.t1))
        ends = start * x.a0, middle * x.a1, middle * x.b0, end * x.b1
        return Segment(x.t0, x.t_break, x.t1, *ends)


class SetPressureGainDrift(CubicDrift, Command):
    """p_set,valve = (1 + g(t)) p_set, with a gain error g that is a function of the time t."""

    title = "gain of the set pressure that drifts during a trial"
    term_curve = Curve("time t", "s", "change of the gain divided by 0.1", "-")

    def command(self, wave, chamber):
        return Scaled(wave, self)


class RearSetPressureGainDrift(RearCommand, SetPressureGainDrift):
    """The gain of the rear chamber's set pressure changes by a function of the time t."""

    title = "gain of the rear chamber's set pressure that drifts during a trial"


class SetPressureTerm(Powers, Command):
    """p_set,valve = p_set + f(p_set)."""

    term_curve = Curve("set pressure p_set", "Pa", "change of the set pressure", "Pa")
    scale: Scalar = shape_parameter(300e3, 1e3, 4e6, "Pa", WHY_SCALE)
    """State beyond which the function is constant. A learned function uses the 99.5 % quantile of
    the visited |p_set|."""

    def state(self, x: Chamber) -> Array:
        """Returns the set pressures."""
        return x.p_set

    @abstractmethod
    def basis(self, z: Array) -> Basis:
        """Returns the basis functions at the set pressure z."""

    def set_pressure(self, p_set: Array) -> Array:
        """Returns the set pressure at the valves for the commanded `p_set`."""
        return p_set + self.total(self.basis(p_set))

    def command(self, wave, chamber):
        return Shaped(wave, self.set_pressure)


class SetPressurePowers(SetPressureTerm):
    """The set pressure changes by an odd function of the commanded set pressure."""

    title = "error of the set pressure"

    def basis(self, z):
        return odd_powers(z / self.scale, PRESSURE)


class SetPressurePowersBySide(SetPressureTerm):
    """The set pressure changes by an even function, so the robot's sides differ."""

    title = "error of the set pressure that differs between the sides"

    def basis(self, z):
        return even_powers(z / self.scale, PRESSURE)


class SetPressureWithCorners(SetPressureTerm):
    """The set pressure changes by an odd function of the commanded set pressure with corners."""

    title = "error of the set pressure, with corners"

    def basis(self, z):
        return odd_corners(z / self.scale, PRESSURE)


class RearSetPressure(RearCommand, SetPressureTerm):
    """The rear chamber's set pressure changes by a function f of the commanded set pressure.

    f is a sum of p_set, |p_set| and p_set^2.
    """

    title = "error of the rear chamber's set pressure"

    def basis(self, z):
        return mixed_powers(z / self.scale, PRESSURE)
