"""Von Karman vortex street."""

import math

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.water.base import WaterField

KARMAN_RATIO = 0.281
"""Distance of the rows divided by the spacing of the vortices in a stable street."""


class VortexStreet(WaterField):
    """A uniform stream with two infinite rows of vortices along x, the wake of a bluff body.

    The vortices of a row are `spacing` a apart. The rows are b = `ratio` a apart, and one row is
    a/2 behind the other one. The vortices of the row at larger y have the circulation Gamma, those
    of the other row -Gamma. A row of circulation G with a vortex at (x_0, y_0) has the velocity

        u_x = -G/(2 a) sinh(Y)/(cosh(Y) - cos(X) + delta^2)
        u_y =  G/(2 a) sin(X)/(cosh(Y) - cos(X) + delta^2)
        X = 2 pi (x - x_0)/a,    Y = 2 pi (y - y_0)/a,    delta^2 = (2 pi r_c/a)^2/2

    In the core, r < r_c, the velocity differs from that of a point vortex. With Gamma > 0, the
    water between the rows moves towards +x relative to the stream: this is the wake of a body at
    larger x in a stream along -x. `karman_speed` returns the speed of the street in the stream.

    Source: Lamb, H. (1932), Hydrodynamics, 6th ed., art. 156; regularisation: Krasny, R. (1986),
    Desingularization of periodic vortex sheet roll-up, J. Comput. Phys. 65, 292-313.
    """

    spacing: Scalar
    """a, distance [m] between two vortices of a row."""
    circulation: Scalar
    """Gamma [m^2/s]; counterclockwise circulation is positive."""
    core: Scalar
    """r_c, radius [m] of the vortices' cores."""
    stream: tuple[Scalar, Scalar] = (0.0, 0.0)
    """Uniform velocity (x, y) [m/s] to which the velocity of the vortices is added."""
    advection: Scalar = 0.0
    """Velocity [m/s] of the vortices along x."""
    position: tuple[Scalar, Scalar] = (0.0, 0.0)
    """Place (x, y) [m], at t = 0, midway between the rows and beside a vortex with Gamma."""
    ratio: Scalar = KARMAN_RATIO
    """b/a, distance of the rows divided by the spacing."""

    def velocity(self, place, t):
        turn = 2.0 * math.pi / self.spacing
        X = turn * (place[0] - self.position[0] - self.advection * t)
        Y = turn * (place[1] - self.position[1])
        half = math.pi * self.ratio
        first = self._row(X, Y - half)
        second = self._row(X + math.pi, Y + half)
        return jnp.stack([u + a - b for u, a, b in zip(self.stream, first, second, strict=True)])

    def _row(self, X, Y):
        """Returns the velocity (x, y) [m/s] of a row with a vortex at X = Y = 0."""
        softening = 0.5 * (2.0 * math.pi * self.core / self.spacing) ** 2
        scale = 0.5 * self.circulation / self.spacing
        # Divided by cosh(Y), so that a far place causes no overflow.
        decay = 1.0 / jnp.cosh(jnp.clip(Y, -300.0, 300.0))
        below = 1.0 + decay * (softening - jnp.cos(X))
        return -scale * jnp.tanh(Y) / below, scale * decay * jnp.sin(X) / below


def karman_speed(spacing: Scalar, circulation: Scalar, ratio: Scalar = KARMAN_RATIO) -> Scalar:
    """Returns the speed [m/s] along x, relative to the stream, of a street of point vortices.

    The speed is Gamma/(2 a) tanh(pi b/a). Source: as in `VortexStreet`.
    """
    return 0.5 * circulation / spacing * jnp.tanh(math.pi * ratio)
