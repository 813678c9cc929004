"""Waveforms of the set pressure. A `Segment` is the set pressure in one time step."""

import math
from abc import abstractmethod
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.parameters import Scalar


class Segment(eqx.Module):
    """Set pressure [Pa] in a time step from `t0` to `t1` [s], linear before and after one break.

    The set pressure is `a0` at `t0`, `a1` before `t_break`, `b0` after `t_break` and `b1` at `t1`.
    """

    t0: Array
    t_break: Array
    t1: Array
    a0: Array
    a1: Array
    b0: Array
    b1: Array


class Waveform(eqx.Module):
    """A set pressure [Pa] as a function of time [s]."""

    @abstractmethod
    def segment(self, t0: Array, t1: Array) -> Segment:
        """Returns the segment from `t0` to `t1` [s]. Subclasses state which segments are exact."""

    def at(self, t: Array) -> Array:
        """Returns the value at `t` [s]."""
        return self.segment(t, t).b1


def _continuous(value, t0, t_break, t1) -> Segment:
    t_break = jnp.clip(t_break, t0, t1)
    middle = value(t_break)
    return Segment(t0, t_break, t1, value(t0), middle, middle, value(t1))


class SquareWave(Waveform):
    """A square wave of +-`amplitude` [Pa], positive in the first half of each period.

    The period is 1/`frequency` [s], and `phase` is the delay as a fraction of a period. The segment
    is exact for steps of up to half a period. The segment is differentiable with respect to
    frequency and phase, because the time of an edge is not rounded to a step. At an edge,
    the pressure has a corner, and derivatives of the pressure are left-sided.
    """

    frequency: Scalar
    amplitude: Scalar
    phase: Scalar = 0.0

    def segment(self, t0, t1):
        def half_turns(t):
            # With this tolerance, an edge at the end of a step is counted in the next step only.
            return jnp.floor(2.0 * (self.frequency * t - self.phase) - 1e-9)

        whole = half_turns(t0)
        crossed = half_turns(t1) > whole
        before = jnp.where(whole % 2.0 == 0.0, self.amplitude, -self.amplitude)
        edge = (0.5 * (whole + 1.0) + self.phase) / self.frequency
        t_break = jnp.where(crossed, edge, t1)
        after = jnp.where(crossed, -before, before)
        return Segment(t0, t_break, t1, before, before, after, after)


class SineWave(Waveform):
    """A sine, amplitude sin(2 pi (frequency t - phase)) [Pa]. Segments have second-order errors."""

    frequency: Scalar
    amplitude: Scalar
    phase: Scalar = 0.0

    def segment(self, t0, t1):
        def value(t):
            return self.amplitude * jnp.sin(2.0 * math.pi * (self.frequency * t - self.phase))

        return _continuous(value, t0, 0.5 * (t0 + t1), t1)


class Trapezoid(Waveform):
    """A square wave whose edges are replaced by ramps, which are centred on the edges.

    `rise` is the length of a ramp as a fraction of a period. The segment is exact for steps that
    are shorter than a ramp and than the plateau between ramps.
    """

    frequency: Scalar
    amplitude: Scalar
    phase: Scalar = 0.0
    rise: Scalar = 0.1

    def segment(self, t0, t1):
        half = 0.5 * self.rise

        def value(t):
            turn = self.frequency * t - self.phase
            from_edge = turn - jnp.round(2.0 * turn) / 2.0
            sign = jnp.where(jnp.round(2.0 * turn) % 2.0 == 0.0, 1.0, -1.0)
            return sign * self.amplitude * jnp.clip(from_edge / half, -1.0, 1.0)

        turn0 = self.frequency * t0 - self.phase
        corners = [
            jnp.floor(2.0 * (turn0 + shift) + 1e-9) / 2.0 + 0.5 - shift for shift in (half, -half)
        ]
        corner = jnp.minimum(*corners)
        return _continuous(value, t0, (corner + self.phase) / self.frequency, t1)


class Recorded(Waveform):
    """Linear interpolation of samples [Pa] at increasing times [s], constant outside these times.

    The segment is exact for steps that are not longer than the sample spacing.
    """

    times: Float[Array, " samples"]
    values: Float[Array, " samples"]

    def segment(self, t0, t1):
        after = jnp.searchsorted(self.times, t0 + 1e-12, side="right")
        t_break = self.times[jnp.minimum(after, self.times.shape[0] - 1)]
        return _continuous(lambda t: jnp.interp(t, self.times, self.values), t0, t_break, t1)


class Held(Waveform):
    """A set pressure that is constant from each of the `times` [s] until the next time.

    The segment is exact for steps that are not longer than the time between samples. If two
    neighbouring `values` [Pa] are equal, derivatives with respect to only one of them are wrong.
    """

    times: Float[Array, " samples"]
    values: Float[Array, " samples"]

    def segment(self, t0, t1):
        last = self.times.shape[0] - 1
        now = jnp.clip(jnp.searchsorted(self.times, t0, side="right") - 1, 0, last)
        following = jnp.minimum(now + 1, last)
        before, after = self.values[now], self.values[following]
        breaks = (before != after) & (self.times[following] < t1)
        t_break = jnp.where(breaks, self.times[following], t1)
        after = jnp.where(breaks, after, before)
        return Segment(t0, t_break, t1, before, before, after, after)


class Delayed(Waveform):
    """`wave`, delayed by `delay` [s]. The set pressure is zero until the delayed wave starts."""

    wave: Waveform
    delay: Scalar

    def segment(self, t0, t1):
        early = self.wave.segment(jnp.where(t0 > self.delay, t0 - self.delay, 0.0), t1 - self.delay)
        smooth = early.t_break >= early.t1
        before = t1 <= self.delay
        # With zero delay, the wave starts at t0. This start is a break, as it moves with `delay`.
        # An edge of the wave at its start is a part of the same break.
        at_start = (t0 == self.delay) & (smooth | (early.t_break <= early.t0))
        starts = ((t0 < self.delay) | at_start) & (t1 > self.delay)

        def choose(inside, beginning):
            return jnp.where(before, 0.0, jnp.where(starts, beginning, inside))

        # If the wave starts within the step, the break is the wave's start, because no edge of the
        # wave follows in this step. If the wave is zero at first, the break is the first edge.
        late = ~smooth & (early.a0 == 0.0)
        break_at = jnp.where(starts & ~late, self.delay, early.t_break + self.delay)
        return Segment(
            t0,
            jnp.where(before, t1, break_at),
            t1,
            choose(early.a0, 0.0),
            choose(early.a1, 0.0),
            choose(early.b0, jnp.where(smooth, early.a0, early.b0)),
            choose(early.b1, early.b1),
        )


class Stretched(Waveform):
    """`wave` at the times (1 - `slow`) t, as a clock generates it that is slow by this fraction.

    The limits of exact segments hold for the steps of the slow or fast clock.
    """

    wave: Waveform
    slow: Scalar

    def segment(self, t0, t1):
        rate = 1.0 - self.slow
        x = self.wave.segment(rate * t0, rate * t1)
        # Rounding must not move the break of a segment without an edge to before its end.
        inside = jnp.minimum(t0 + (x.t_break - x.t0) / rate, t1)
        t_break = jnp.where(x.t_break >= x.t1, t1, inside)
        return Segment(t0, t_break, t1, x.a0, x.a1, x.b0, x.b1)


class Shaped(Waveform):
    """The set pressure curve(wave), for a function `curve` of a set pressure [Pa].

    Segments are exact if `curve` is linear or `wave` is piecewise constant. `curve` must be a
    pytree, such as a method of an effect.
    """

    wave: Waveform
    curve: Callable[[Array], Array]

    def segment(self, t0, t1):
        x = self.wave.segment(t0, t1)
        ends = (self.curve(p) for p in (x.a0, x.a1, x.b0, x.b1))
        return Segment(x.t0, x.t_break, x.t1, *ends)


class Fading(Waveform):
    """The set pressure exp(-rate t) wave, which decreases with the time t [s].

    The unit of `rate` is 1/s. If `wave` is piecewise constant, the relative error of a segment is
    at most (rate step)^2/8.
    """

    wave: Waveform
    rate: Scalar

    def segment(self, t0, t1):
        x = self.wave.segment(t0, t1)
        start, middle, end = (jnp.exp(-self.rate * t) for t in (x.t0, x.t_break, x.t1))
        return Segment(
            x.t0, x.t_break, x.t1, start * x.a0, middle * x.a1, middle * x.b0, end * x.b1
        )
