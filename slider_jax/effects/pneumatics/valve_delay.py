"""Dead time of the valves."""

import jax.numpy as jnp

from slider_jax.actuation.waveform import Segment, Waveform
from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Command, parameter


class Delayed(Waveform):
    """`wave`, later by `delay` [s]; what it would give before t = 0 is zero."""

    wave: Waveform
    delay: Scalar

    def segment(self, t0, t1):
        early = self.wave.segment(jnp.where(t0 > self.delay, t0 - self.delay, 0.0), t1 - self.delay)
        smooth = early.t_break >= early.t1
        before = t1 <= self.delay
        # Also at no delay, where it takes no time: so the start moves with the delay from null on.
        starts = ((t0 < self.delay) | ((t0 == self.delay) & smooth)) & (t1 > self.delay)

        def choose(inside, beginning):
            return jnp.where(before, 0.0, jnp.where(starts, beginning, inside))

        # Where it starts within the step, the break is the start: no edge falls so soon after. A
        # wave that is zero at its start has its first edge for a start.
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


class ValveDelay(Command):
    """The valves follow the command a dead time later.

        p_set,valve(t) = p_set(t - delay)

    Source: solenoid valves' switching times, Beater, P. (2007), Pneumatic Drives, Springer, ch. 5.
    """

    title = "dead time of the valves"
    sensors = ("pressure", "thrust", "recoil", "tip")

    delay: Scalar = parameter(
        0.0, 0.0, 0.06, "s", "5 to 30 ms to switch, and the controller's cycle"
    )
    """Dead time."""

    def command(self, wave, chamber):
        return Delayed(wave, self.delay)
