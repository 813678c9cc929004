"""Support of a climbing robot: a pin holds the head through a rigid cross-link."""

import equinox as eqx
import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.beam.spatial import Vec
from slider_jax.beam.state import to_plane
from slider_jax.supports.base import Start, Support


class PinnedLink(Support):
    """A massless rigid link across the head, of length l_p = `link_length` [m], pinned at one end.

    The vector from the head to the pin is sigma (l_p/2) n, with sigma = +1 or -1. The pin does not
    move and carries no moment:

        V_tau - sigma (l_p/2) omega = 0,    V_n = 0,    M + sigma (l_p/2) T = 0

    The first two conditions are V + omega x r = 0, with the vector r from the head to the pin. The
    paper writes the curvature Omega instead of omega (docs/explanation/decisions.md).

    In space, the link turns about the axis b only.

    sigma is +1 in the first half of every period 1/`frequency` [s] and -1 in the second half.
    `phase` is the delay of these periods, as a fraction of a period. With `frequency` = 0, sigma is
    always +1. sigma is constant within a time step: `during` uses the sigma of mid-step.
    """

    link_length: Scalar = eqx.field(default=0.03)
    frequency: Scalar = eqx.field(default=0.0)
    phase: Scalar = eqx.field(default=0.0)

    def side(self, t):
        """Returns the sign sigma at `t` [s]."""
        turn = self.frequency * t - self.phase
        return jnp.where((self.frequency > 0) & (turn - jnp.floor(turn) >= 0.5), -1.0, 1.0)

    def arm(self, t):
        """Returns the position sigma l_p/2 [m] of the pin along n, relative to the head."""
        return 0.5 * self.link_length * self.side(t)

    def during(self, t0, t1):
        signed_length = 2.0 * self.arm(0.5 * (t0 + t1))
        zero = jnp.zeros_like(signed_length)
        return PinnedLink(signed_length, frequency=zero, phase=zero)

    def rows(self, head, omega, t):
        arm = self.arm(t)
        return head.V_tau - arm * omega, head.V_n, head.M + arm * head.T

    def start(self, t):
        zero = jnp.zeros(())
        return Start((zero, zero), zero, zero)

    def sensor_angle(self, phi, t):
        return phi

    def anchor_offset(self, phi, t):
        return jnp.stack(to_plane(0.0, self.arm(t), phi))

    def anchor_velocity(self, head, omega, t):
        return jnp.stack(to_plane(head.V_tau - self.arm(t) * omega, head.V_n, head.phi))

    def rows_in_space(self, head, frame, omega, t):
        at_pin = head.V.plus(omega.cross(self.anchor_in_space(t)))
        return *at_pin, omega.tau, omega.n, head.M.b + self.arm(t) * head.T.tau

    def anchor_in_space(self, t):
        zero = jnp.zeros(())
        return Vec(zero, self.arm(t), zero)
