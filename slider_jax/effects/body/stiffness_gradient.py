"""A body whose stiffness changes from head to tail."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BendingMoment, parameter


class StiffnessGradient(BendingMoment):
    """The bending stiffness of the actuated body changes linearly along the body.

        M = EI (1 + g xi) (kappa + alpha d(kappa)/dt)

    xi is the distance from the middle of the body, divided by the body's length: 1/2 at the head
    and -1/2 at the joint. alpha is the damping time. The mean stiffness is unchanged. Source:
    tapered beams, Gere, J. M. and Timoshenko, S. P. (1997), Mechanics of Materials, 4th ed., ch. 9.
    """

    title = "the body's stiffness changes along the body"
    order = 720
    segments = ("body",)

    g: Scalar = parameter(
        0.0,
        -0.8,
        0.8,
        "-",
        "hoses end along the body, and castings differ in thickness by 10 %",
        physical=(-1.9, 1.9),
    )
    """g, stiffness at the head minus stiffness at the joint, divided by the mean stiffness."""

    def moment(self, x, memory, dt):
        body = 1.0 - x.in_tail
        length = jnp.sum(body * x.ds)
        middle = jnp.sum(body * x.s * x.ds) / length
        change = self.g * body * (x.s - middle) / length
        return change * x.EI * (x.kappa + x.damping_time * x.kappa_t), memory
