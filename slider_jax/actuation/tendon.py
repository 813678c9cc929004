"""Tendons: cables inside the body, pulled with a given tension or by a given length.

A tendon runs at the offset e(d) from the axis, on the side of n (left of the head's direction) if e
is positive. Its tension P acts on the body as the couple and the compression

    M_act = P e,        T = EA (eps + alpha d(eps)/dt) + P

in the span, since the net axial force T contains the tension. The elongation of the tendon is the
integral of eps - e kappa over the span. Friction, the mass of the tendon and squares of de/ds are
neglected. Source: Rucker, D. C., Webster, R. J. (2011), Statics and dynamics of continuum robots
with general tendon routing and external loading, IEEE Trans. Robot. 27, 1033-1044; here in a plane,
for small slopes of the tendon relative to the axis.

In three dimensions, the tendon runs at the offset e in the direction of its `angle` about the axis.
`spatial.lines` contains its loads.
"""

from abc import abstractmethod
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.actuation.actuator import Actuator
from slider_jax.actuation.waveform import Waveform
from slider_jax.beam.parameters import Scalar


def _ends(values: Scalar | tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
    return values if isinstance(values, tuple) else (values, values)


class Tendon(Actuator):
    """A tendon that is attached to the body at both ends of its span."""

    offset: Scalar | tuple[Scalar, Scalar]
    """Offset e [m], or its values at the near and far end; between the ends, e is linear."""
    angle: Scalar | tuple[Scalar, Scalar] = eqx.field(default=0.0, kw_only=True)
    """Angle [rad] about the axis, from n towards b, or its values at the near and far end. Between
    the ends, it is linear, so two different values give a helix. It is 0 in the plane."""

    elastic: ClassVar[bool] = False
    """Whether the tension depends on the elongation."""

    def offset_at(self, distance: Float[Array, " cells"]) -> Float[Array, " cells"]:
        """Returns the offset e [m] at `distance` [m] from the head."""
        return self._linear(self.offset, distance)

    def angle_at(self, distance: Float[Array, " cells"]) -> Float[Array, " cells"]:
        """Returns the angle [rad] at `distance` [m] from the head."""
        return self._linear(self.angle, distance)

    @property
    def angle_rate(self) -> Scalar:
        """Change [rad/m] of the angle along s, which points towards the head."""
        near, far = _ends(self.angle)
        return -(far - near) / (self.far - self.near)

    def _linear(self, values: Scalar | tuple[Scalar, Scalar], distance: Array) -> Array:
        near, far = _ends(values)
        return near + (far - near) * (distance - self.near) / (self.far - self.near)

    @abstractmethod
    def tension(self, elongation: Array, t: Array) -> Array:
        """Returns the tension P [N] at an `elongation` [m] and the time `t` [s]."""


class TensionTendon(Tendon):
    """A tendon with a given tension, such as that of a motor with torque control."""

    wave: Waveform
    """Tension P [N]; a negative tension of the waveform counts as zero."""

    def tension(self, elongation, t):
        return jnp.maximum(self.wave.at(t), 0.0)


class LengthTendon(Tendon):
    """An elastic tendon whose motor pulls in a given length, such as that of a servo.

        P = stiffness (pull + elongation)

    A slack tendon has no tension. If the tendon `pushes`, P may be negative, as for a rod.
    """

    pull: Waveform
    """Length [m] that the motor pulls in, relative to the straight unloaded body."""
    stiffness: Scalar
    """Stiffness [N/m] of the whole tendon, with its motor."""
    pushes: bool = eqx.field(static=True, default=False)

    elastic: ClassVar[bool] = True

    def tension(self, elongation, t):
        P = self.stiffness * (self.pull.at(t) + elongation)
        return P if self.pushes else jnp.maximum(P, 0.0)
