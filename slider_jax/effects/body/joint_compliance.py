"""A soft joint between body and tail."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BendingMoment, parameter


class JointCompliance(BendingMoment):
    """The adapter between body and tail is a hinge with the stiffness 1/c.

        kappa + alpha d(kappa)/dt = M/EI + c M delta(s - s_joint)

    The hinge has the damping time alpha of the body. Source: springs in series, Gere, J. M. and
    Timoshenko, S. P. (1997), Mechanics of Materials, 4th ed., ch. 2.
    """

    title = "the joint of the tail is soft"
    order = 800
    segments = ("body", "tail")

    compliance: Scalar = parameter(
        0.0, 0.0, 5.0, "rad/(N m)", "0 for a rigid adapter; the tail's own L/EI is 12 rad/(N m)"
    )
    """c, rotation of the joint per moment."""

    def moment(self, x, memory, dt):
        rigid = x.EI * (x.kappa + x.damping_time * x.kappa_t)
        softness = self.compliance * x.EI * x.joint
        return -rigid * softness / (1.0 + softness), memory
