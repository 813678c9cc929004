"""A square wave whose frequency, amplitude, delay and mean change with time."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.actuation.waveform import Segment, Waveform
from slider_jax.beam.clock import Clock


class ScheduledSquareWave(Waveform):
    """The square wave bias(t) +- amplitude(t) [Pa], positive in the first half of each period.

    The periods are those of the `clock`, delayed by phase(t) periods. Amplitude, phase and bias are
    linear between their values at the clock's times, and constant outside them. Within a step, the
    phase is taken as linear, so a segment has an error of second order in the step where the
    frequency changes, and is exact elsewhere. Steps must be shorter than half a period.
    """

    clock: Clock
    amplitude: Float[Array, " knots"]
    phase: Float[Array, " knots"]
    bias: Float[Array, " knots"]

    def segment(self, t0, t1):
        def value(name, t):
            at = jnp.asarray(self.clock.times, float)
            return jnp.interp(t, at, jnp.asarray(getattr(self, name), float))

        begin, end = (self.clock.turns(t) - value("phase", t) for t in (t0, t1))
        # With this tolerance, an edge at the end of a step is counted in the next step only.
        whole = jnp.floor(2.0 * begin - 1e-9)
        crossed = jnp.floor(2.0 * end - 1e-9) > whole
        share = (0.5 * (whole + 1.0) - begin) / jnp.where(crossed, end - begin, 1.0)
        t_break = jnp.where(crossed, t0 + jnp.clip(share, 0.0, 1.0) * (t1 - t0), t1)
        before = jnp.where(whole % 2.0 == 0.0, 1.0, -1.0)
        after = jnp.where(crossed, -before, before)

        def pressure(sign, t):
            return sign * value("amplitude", t) + value("bias", t)

        return Segment(
            t0, t_break, t1, pressure(before, t0), pressure(before, t_break),
            pressure(after, t_break), pressure(after, t1),
        )  # fmt: skip
