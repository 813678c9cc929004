"""Dry friction in the tail."""

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import BendingMoment, parameter, shape_parameter
from slider_jax.effects.body.internal_friction import dahl_state


class TailFriction(BendingMoment):
    """Friction between the layers or ribs of the passive tail, with the law of `InternalFriction`.

        M = EI kappa + z_c q,    kappa_c dq/dt = d(kappa)/dt - |d(kappa)/dt| q

    The state q changes from -1 to 1 while the curvature changes by a few kappa_c. Source: Dahl, P.
    R. (1976), Solid friction damping of mechanical vibrations, AIAA J. 14, 1675-1682.
    """

    title = "dry friction in the tail"
    order = 760
    segments = ("tail",)

    z_c: Scalar = parameter(
        0.0, 0.0, 0.005, "N m", "a fifth of the moment of a tail with EI = 0.0058 N m^2 and 4 1/m"
    )
    """z_c, largest friction moment."""
    kappa_c: Scalar = shape_parameter(
        0.5, 0.1, 5.0, "1/m", "a fortieth to all of the tail's curvature in a typical stride"
    )
    """kappa_c, curvature scale of q."""

    def moment(self, x, memory, dt):
        q = dahl_state(memory, x.kappa_t, dt, self.kappa_c)
        return x.in_tail * self.z_c * q, q
