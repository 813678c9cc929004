"""Set pressures in time. Each is piecewise linear, with at most one break within a time step."""

import math
from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.parameters import Scalar


class Segment(eqx.Module):
    """Set pressure [Pa] over [t0, t1]: `a0` to `a1` until `t_break`, then `b0` to `b1`, linear."""

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
        """What the set pressure does over [t0, t1], exact where the class says so."""


def _continuous(value, t0, t_break, t1) -> Segment:
    t_break = jnp.clip(t_break, t0, t1)
    middle = value(t_break)
    return Segment(t0, t_break, t1, value(t0), middle, middle, value(t1))


class SquareWave(Waveform):
    """+-amplitude [Pa], positive in the first half of a period 1/frequency [Hz], after `phase`.

    `phase` is the delay as a fraction of a period. Exact for steps up to half a period, and
    differentiable to frequency and phase: the edge is a time, not an index, and an edge that falls
    on the end of a step moves through it. The pressure at the instant of an edge has a corner; its
    derivative there is that from before.
    """

    frequency: Scalar
    amplitude: Scalar
    phase: Scalar = 0.0

    def segment(self, t0, t1):
        def half_turns(t):
            # Rounding must not move an edge that falls on a step into the step before.
            return jnp.floor(2.0 * (self.frequency * t - self.phase) - 1e-9)

        whole = half_turns(t0)
        crossed = half_turns(t1) > whole
        before = jnp.where(whole % 2.0 == 0.0, self.amplitude, -self.amplitude)
        edge = (0.5 * (whole + 1.0) + self.phase) / self.frequency
        t_break = jnp.where(crossed, edge, t1)
        after = jnp.where(crossed, -before, before)
        return Segment(t0, t_break, t1, before, before, after, after)


class SineWave(Waveform):
    """amplitude sin(2 pi (f t - phase)) [Pa]; linear within a step, second order in it."""

    frequency: Scalar
    amplitude: Scalar
    phase: Scalar = 0.0

    def segment(self, t0, t1):
        def value(t):
            return self.amplitude * jnp.sin(2.0 * math.pi * (self.frequency * t - self.phase))

        return _continuous(value, t0, 0.5 * (t0 + t1), t1)


class Trapezoid(Waveform):
    """A square wave whose edges are ramps over `rise` (fraction of a period), centred on the edges.

    Exact for steps shorter than the ramp and the plateau.
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
    """Samples [Pa] at increasing times [s], linear between them, constant outside.

    Exact for steps no longer than the spacing of the samples.
    """

    times: Float[Array, " samples"]
    values: Float[Array, " samples"]

    def segment(self, t0, t1):
        after = jnp.searchsorted(self.times, t0 + 1e-12, side="right")
        t_break = self.times[jnp.minimum(after, self.times.shape[0] - 1)]
        return _continuous(lambda t: jnp.interp(t, self.times, self.values), t0, t_break, t1)


class Held(Waveform):
    """Set pressures [Pa] from the times [s] on at which they were given, each until the next.

    Exact for steps no longer than the time between changes. Where two neighbours are equal there
    is no break, as in a wave that does not change; derivatives to single values are therefore not
    to be had.
    """

    times: Float[Array, " samples"]
    values: Float[Array, " samples"]

    def segment(self, t0, t1):
        last = self.times.shape[0] - 1
        here = jnp.searchsorted(self.times, t0, side="right") - 1
        here = jnp.clip(here, 0, last)
        coming = jnp.minimum(here + 1, last)
        before, after = self.values[here], self.values[coming]
        breaks = (before != after) & (self.times[coming] < t1)
        t_break = jnp.where(breaks, self.times[coming], t1)
        after = jnp.where(breaks, after, before)
        return Segment(t0, t_break, t1, before, before, after, after)
