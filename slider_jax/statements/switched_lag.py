"""The pressure of a chamber as the paper prints it, with a given pressure after each switch."""

import jax.numpy as jnp

from slider_jax.actuation.waveform import Segment, Waveform
from slider_jax.beam.parameters import Scalar


class SwitchedLag(Waveform):
    """The pressure itself, for the law `Ideal`: a first-order lag that restarts at each switch.

        p(t) = p_set - exp(-t/k) (p_set - p_0),    t: time since the last switch of p_set

    p_set is a square wave of +-`amplitude` [Pa]. If `start` is -1, p_0 is the pressure at the
    previous switch in the periodic state of the lag, so p is continuous. Other values of `start`
    are readings of the paper's p_0, with which p jumps at each switch: 0 for p_0 = 0, and 1 for
    p_0 = p_set (1 - exp(-1/(2 f k))). Between these values, p_0 is linear in `start`. A segment is
    exact at its end only. Source: Van Stratum et al., section "Actuation".
    """

    frequency: Scalar
    amplitude: Scalar
    k: Scalar
    """Time constant [s]."""
    start: Scalar = -1.0
    phase: Scalar = 0.0

    def segment(self, t0, t1):
        before, after = self.at(t0), self.at(t1)
        return Segment(t0, t1, t1, before, after, after, after)

    def at(self, t):
        half_turns = 2.0 * (self.frequency * t - self.phase)
        # At a switch, the result is the pressure before the switch, as in `SquareWave`.
        whole = jnp.floor(half_turns - 1e-9)
        share = half_turns - whole
        half_period = 0.5 / (self.frequency * self.k)
        periodic = -jnp.tanh(0.5 * half_period)
        printed = -jnp.expm1(-half_period)
        first = jnp.where(self.start < 0.0, -self.start * periodic, self.start * printed)
        relative = 1.0 - jnp.exp(-share * half_period) * (1.0 - first)
        return jnp.where(whole % 2.0 == 0.0, 1.0, -1.0) * self.amplitude * relative
