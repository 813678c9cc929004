"""Terms of the set pressure at the valves."""

from abc import abstractmethod
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array

from slider_jax.actuation.waveform import Delayed, Segment, Shaped, Waveform
from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Chamber, Command, Curve, parameter, shape_parameter
from slider_jax.effects.dictionary.flow import WHY_SCALE
from slider_jax.effects.functions import (
    WHY_FACTOR,
    WHY_FREQUENCY,
    Basis,
    Powers,
    RigDrift,
    Sine,
    even_powers,
    mixed_powers,
    odd_corners,
    odd_powers,
)

DELAY = 2e-3
"""Delay [s] that one unit of a delay's parameters causes. The largest parameters add 40 ms."""
GAIN = 0.1
"""Relative change of the set pressure that one unit of a gain's parameters causes."""
OSCILLATION = 100e3
"""Pressure [Pa] that one unit of a sine's parameters adds."""
WHY_GAIN = "a supply with a larger pulsation drives no robot"
PRESSURE = 20e3
"""Pressure [Pa] that one unit of a term's parameters adds: a tenth of a typical pressure."""
ITERATIONS = 5
"""Fixed-point iterations for the time of an edge. Each multiplies the error by the rate of the
delay, which is about 0.01, and 0.2 for the fastest drift."""


class Selected(Waveform):
    """The set pressure `changed` if `applies` is true, otherwise `wave`."""

    applies: Array
    changed: Waveform
    wave: Waveform

    def segment(self, t0, t1):
        changed, wave = self.changed.segment(t0, t1), self.wave.segment(t0, t1)
        return jax.tree.map(lambda x, y: jnp.where(self.applies, x, y), changed, wave)


class RearCommand:
    """The last chamber; only its set pressure changes."""

    def command(self, wave, rear):
        return Selected(rear == 1.0, super().command(wave, rear), wave)  # type: ignore[misc]


class Drifting(Waveform):
    """`wave` at the times t - d(t), with a delay d that changes slowly."""

    wave: Waveform
    drift: RigDrift

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


class SetPressureDelayDrift(RigDrift, Command):
    """p_set,valve(t) = p_set(t - d(t)), with a delay d that is a function of the time t."""

    title = "delay of the set pressure that drifts during a trial"
    term_curve = Curve("time t", "s", "delay divided by 2 ms", "-")

    def command(self, wave, rear):
        return Drifting(wave, self)


class EdgeDelayed(Waveform):
    """`wave` with the delay `up` [s] while it rises, and the delay `down` [s] while it falls.

    The difference of the delays must be shorter than the time between two edges.
    """

    wave: Waveform
    up: Scalar
    down: Scalar

    def segment(self, t0, t1):
        up, down = (Delayed(self.wave, x).segment(t0, t1) for x in (self.up, self.down))
        rises, falls = up.b1 > up.a0, down.b1 < down.a0
        # Between the edges of `up` and `down`, the edge with the longer delay is still to come.
        lower = jnp.asarray(self.up) >= self.down

        def choose(u, d):
            between = jnp.where(lower, jnp.minimum(u, d), jnp.maximum(u, d))
            return jnp.where(rises, u, jnp.where(falls, d, between))

        ends = (choose(getattr(up, x), getattr(down, x)) for x in ("a0", "a1", "b0", "b1"))
        t_break = jnp.where(rises, up.t_break, jnp.where(falls, down.t_break, t1))
        return Segment(t0, t_break, t1, *ends)


class SetPressureDelayOfEdges(Command):
    """The set pressure is delayed by 2 ms times a while it rises, and times b while it falls."""

    title = "different delays of the set pressure while it rises and while it falls"
    term_curve = Curve("sign of p_set - p", "-", "delay divided by 2 ms", "-")

    a: Scalar = parameter(0.0, -20.0, 20.0, "-", WHY_FACTOR)
    """a, delay of rising edges."""
    b: Scalar = parameter(0.0, -20.0, 20.0, "-", WHY_FACTOR)
    """b, delay of falling edges."""

    def state(self, x: Chamber) -> Array:
        """Returns 1 if the pressures rise, and -1 if they fall."""
        return jnp.sign(x.p_set - x.p)

    def basis(self, z: Array) -> tuple[Array, Array]:
        """Returns whether z is positive, and whether it is not."""
        rises = jnp.where(z > 0.0, 1.0, 0.0)
        return rises, 1.0 - rises

    def command(self, wave, rear):
        return EdgeDelayed(wave, DELAY * self.a, DELAY * self.b)


class Varying(Waveform):
    """`wave` plus a pressure that depends on the time and on the set pressure.

    If `wave` is piecewise constant, the error of a segment is of second order in the step.
    """

    wave: Waveform
    change: Callable[[Array, Array], Array]
    """Returns the additional pressure [Pa] at a time [s] and set pressure [Pa]. It must be a
    pytree, such as a method of an effect."""

    def segment(self, t0, t1):
        x = self.wave.segment(t0, t1)
        times, ends = (x.t0, x.t_break, x.t_break, x.t1), (x.a0, x.a1, x.b0, x.b1)
        changed = (p + self.change(t, p) for t, p in zip(times, ends, strict=True))
        return Segment(x.t0, x.t_break, x.t1, *changed)


class SetPressureGainDrift(RigDrift, Command):
    """p_set,valve = (1 + g(t)) p_set, with a gain error g that is a function of the time t."""

    title = "gain of the set pressure that drifts during a trial"
    term_curve = Curve("time t", "s", "change of the gain divided by 0.1", "-")

    def change(self, t: Array, p_set: Array) -> Array:
        """Returns the additional pressure [Pa] at the time t."""
        return GAIN * self.at(t) * p_set

    def command(self, wave, rear):
        return Varying(wave, self.change)


class RearSetPressureGainDrift(RearCommand, SetPressureGainDrift):
    """The gain of the last chamber's set pressure changes by a function of the time t."""

    title = "gain of the last chamber's set pressure that drifts during a trial"


class SetPressureSineTerm(Sine, Command):
    """The set pressure at the valves contains a sine."""

    a: Scalar = parameter(0.0, -1.0, 1.0, "-", WHY_GAIN)
    """a, amplitude of the sine."""
    b: Scalar = parameter(0.0, -1.0, 1.0, "-", WHY_GAIN)
    """b, amplitude of the cosine."""
    frequency: Scalar = shape_parameter(10.0, 0.1, 500.0, "Hz", WHY_FREQUENCY)
    """f, frequency of the most significant sine in the residual."""

    @abstractmethod
    def change(self, t: Array, p_set: Array) -> Array:
        """Returns the additional pressure [Pa] at the time t."""

    def command(self, wave, rear):
        return Varying(wave, self.change)


class SetPressureGainSine(SetPressureSineTerm):
    """p_set,valve = p_set (1 + a sin(2 pi f t) + b cos(2 pi f t)), with the frequency f.

    The pulsation of a compressor or of a supply has this form.
    """

    title = "a sine in the gain of the set pressure"
    term_curve = Curve("phase, the fraction of f t", "-", "change of the gain", "-")
    of_gain = True

    def change(self, t, p_set):
        return self.at(t) * p_set


class SetPressureSine(SetPressureSineTerm):
    """p_set,valve = p_set + P (a sin(2 pi f t) + b cos(2 pi f t)), with P = 100 kPa.

    The oscillation of a regulator has this form.
    """

    title = "a sine in the set pressure"
    term_curve = Curve("phase, the fraction of f t", "-", "change of p_set divided by 100 kPa", "-")

    def change(self, t, p_set):
        return OSCILLATION * self.at(t)


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

    def command(self, wave, rear):
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
    """The last chamber's set pressure changes by a function f of the commanded set pressure.

    f is a sum of p_set, |p_set| and p_set^2.
    """

    title = "error of the last chamber's set pressure"

    def basis(self, z):
        return mixed_powers(z / self.scale, PRESSURE)
