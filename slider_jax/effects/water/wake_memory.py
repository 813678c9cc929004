"""Reactive force that follows the motion with the delay of the wake."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import WakeForce, parameter, shape_parameter
from slider_jax.effects.water.reactive import ReactiveForce

WEIGHTS = np.array([0.33, 0.67])[:, None]
"""Parts of the delayed force that belong to the two rates."""
RATES = np.array([0.0455, 0.3])[:, None]
"""Rates of the two parts per half height of travel."""
SLOWEST = 1e-3
"""Speed [m/s] below which the speed is smoothed, so that its derivative is finite."""


class WakeMemory(WakeForce):
    """A part of the reactive force grows while the section leaves its wake behind.

    g is the force F_n of `ReactiveForce` with the added-mass coefficient m_w, the delayed part:

        F_n      = -(g - 0.33 q_1 - 0.67 q_2)
        dq_i/dt  = b_i |u|/(lambda H/2) (g - q_i),    b = 0.0455, 0.3

    After a sudden start at constant |u|, the force of a model with the added-mass coefficient m_a
    is the final force times 1 - (m_w/m_a)(0.33 exp(-0.0455 x) + 0.67 exp(-0.3 x)), with the number
    x of half heights that the section has travelled. For m_w = m_a/2 and lambda = 1, this is
    Wagner's function in the approximation of Jones. Wagner's theory of wings delays only the lift
    due to circulation. Here the part m_w of the inertial force is delayed too, because a robot
    without forward speed has hardly another reactive force; this is an assumption, which data have
    to confirm. The tangential force has no delay, because it is zero for a body of uniform height.
    Below 1 mm/s, the speed |u| is smoothed.

    Source: Wagner, H. (1925), Ueber die Entstehung des dynamischen Auftriebes von Tragfluegeln, Z.
    angew. Math. Mech. 5, 17-35; Jones, R. T. (1940), The unsteady lift of a wing of finite aspect
    ratio, NACA Report 681.
    """

    states = 2
    title = "the wake delays the reactive force"
    order = 502

    m_w: Scalar = parameter(
        0.0,
        -0.1,
        0.8,
        "-",
        "half of m_a for a wing; m_a of plates is 0.5 to 1.5",
        physical=(-1.5, 1.5),
    )
    """m_w, delayed part of the added-mass coefficient m_a."""
    travel: Scalar = shape_parameter(
        1.0, 0.2, 5.0, "-", "1 for a wing of large span; 0.5 for a wing as long as its span"
    )
    """lambda, factor of the travel in which the force grows."""
    density: Scalar = eqx.field(default=1000.0)
    """Density rho [kg/m^3] of the water."""

    def wake_force(self, x, memory, dt):
        _, g = ReactiveForce(1.0, self.density).force(x)
        speed = jnp.sqrt(x.u_tau**2 + x.u_n**2 + SLOWEST**2)
        share = dt * RATES * speed / (0.5 * self.travel * x.height)
        q = (memory + share * g) / (1.0 + share)
        F_n = -self.m_w * (g - jnp.sum(WEIGHTS * q, axis=0))
        return (jnp.zeros_like(F_n), F_n), q
