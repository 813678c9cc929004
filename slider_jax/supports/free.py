"""Free head, for swimming."""

import jax.numpy as jnp

from slider_jax.frame import to_plane
from slider_jax.supports.base import Support


class Free(Support):
    """No force and no moment at the head: T = N = M = 0. The anchored point is the head itself."""

    def rows(self, head, omega, t):
        return head.T, head.N, head.M

    def initial(self):
        zero = jnp.zeros(())
        return (zero, zero), zero

    def anchor_velocity(self, head, omega, t):
        return jnp.stack(to_plane(head.V_tau, head.V_n, head.phi))

    def head_position(self, anchor, phi, t):
        return anchor

    def reanchor(self, anchor, phi, t_before, t):
        return anchor
