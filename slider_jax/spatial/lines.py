"""Loads of the tendons and chambers that run beside the axis of a body in space.

A line runs at the place (n, b) = r (cos(a), sin(a)) of the section, with the offset r and the angle
a about the axis. Per length of the axis, the line advances by

    l_tau = 1 + eps + Omega_n b - Omega_b n,        l_a = r (da/ds + Omega_tau)

along tau and around the axis, and its length is l = sqrt(l_tau^2 + l_a^2) per length of the axis.
By the principle of virtual work, a tension P exerts on the body the compression P l_tau/l and the
moments

    M_act = P r (-l_a/l tau - l_tau/l sin(a) n + l_tau/l cos(a) b).

As in the plane, squares of dr/ds are neglected, and also friction and the mass of the tendon. A
chamber is a line that pushes. Its compression is neglected, as in the plane: it exerts moments.
Source: Rucker, D. C., Webster, R. J. (2011), Statics and dynamics of continuum robots with general
tendon routing and external loading, IEEE Trans. Robot. 27, 1033-1044.
"""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.actuation import Actuator, Tendon
from slider_jax.beam.parameters import Scalar
from slider_jax.beam.spatial import SpatialReference, SpatialStructure, Vec, strain_in_space
from slider_jax.dynamics.model import SpaceSettings
from slider_jax.dynamics.tendons import tendons_of


class LineCourse(NamedTuple):
    """Unit tangent of lines in the cells, and their lengths per length of the axis."""

    along: Float[Array, "lines cells"]
    """l_tau/l [-]."""
    around: Float[Array, "lines cells"]
    """l_a/l [-]."""
    length: Float[Array, "lines cells"]
    """l [-]."""


class Lines(eqx.Module):
    """Places of lines in the cells."""

    offset: Float[Array, "lines cells"]
    """r [m]."""
    angle: Float[Array, "lines cells"]
    """a [rad], from n towards b."""
    rate: Float[Array, "lines cells"]
    """da/ds [rad/m]."""

    def course(self, strain: Array, curvature: Vec) -> LineCourse:
        """Returns the course at a `strain` [-] and a `curvature` [1/m] (cells,) of the body."""
        n, b = self.offset * jnp.cos(self.angle), self.offset * jnp.sin(self.angle)
        along = 1.0 + strain + curvature.n * b - curvature.b * n
        around = self.offset * (self.rate + curvature.tau)
        length = jnp.sqrt(along**2 + around**2)
        return LineCourse(along / length, around / length, length)

    def moment(self, size: Float[Array, "lines cells"], course: LineCourse) -> Vec:
        """Returns the active moment [N m] (cells,) of lines with the products `size` = P r."""
        bending = size * course.along
        return Vec(
            -jnp.sum(size * course.around, axis=0),
            -jnp.sum(bending * jnp.sin(self.angle), axis=0),
            jnp.sum(bending * jnp.cos(self.angle), axis=0),
        )


class ChamberLines(eqx.Module):
    """Chambers at a distance d from the axis, with given pressures p.

    A positive p is the pressure of a chamber that pushes at the offset -d, and a negative p that of
    the opposite chamber. In both cases, P r = K_Q p.
    """

    places: Lines
    size: Float[Array, "chambers cells"]
    """K_Q p [N m]."""

    def moment(self, strain: Array, curvature: Vec) -> Vec:
        """Returns the active moment [N m] (cells,)."""
        return self.places.moment(self.size, self.places.course(strain, curvature))


class TendonLines(eqx.Module):
    """The tendons and their places in the cells."""

    tendons: tuple[Tendon, ...]
    places: Lines
    share: Float[Array, "tendons cells"]
    """Fraction of each cell that is inside the span."""

    @property
    def elastic(self) -> bool:
        """Whether a tension depends on the elongation of its tendon."""
        return any(tendon.elastic for tendon in self.tendons)

    def strain(
        self,
        tension: Float[Array, " tendons"],
        T: Array,
        curvature: Vec,
        body: SpatialStructure,
        reference: SpatialReference,
    ) -> Float[Array, " cells"]:
        """Returns the strain [-] at the net axial force `T` [N], which contains the tensions."""
        P, free = tension[:, None] * self.share, strain_in_space(T, body, reference)
        soft = self._softness(body, reference)
        strain = free - soft * jnp.sum(P, axis=0)
        # Two Newton steps; a fixed-point step already reduces the error by about P/EA.
        for _ in range(2):
            along, around, length = self.places.course(strain, curvature)
            error = strain - free + soft * jnp.sum(P * along, axis=0)
            strain = strain - error / (1.0 + soft * jnp.sum(P * around**2 / length, axis=0))
        return strain

    def _softness(self, body: SpatialStructure, reference: SpatialReference) -> Array:
        """Returns the strain of a unit force [1/N]."""
        none = replace(reference, strain=jnp.zeros_like(body.ds))
        return strain_in_space(jnp.ones_like(body.ds), body, none)

    def loads(
        self, tension: Float[Array, " tendons"], strain: Array, curvature: Vec
    ) -> tuple[Array, Vec]:
        """Returns the compression [N] and the active moment [N m] (cells,)."""
        P, course = tension[:, None] * self.share, self.places.course(strain, curvature)
        moment = self.places.moment(P * self.places.offset, course)
        return jnp.sum(P * course.along, axis=0), moment

    def tensions(
        self,
        T: Array,
        curvature: Vec,
        body: SpatialStructure,
        reference: SpatialReference,
        t: Array,
    ) -> Float[Array, " tendons"]:
        """Returns the tensions [N]; see `dynamics.tendons.tensions`.

        The elongations are almost linear in the tensions, since a tendon also compresses the body.
        One more step of Newton's method than in the plane removes what is not linear.
        """

        def tension(elongations):
            pairs = zip(self.tendons, elongations, strict=True)
            return jnp.stack([jnp.asarray(x.tension(c, t), float) for x, c in pairs])

        zero = jnp.zeros(len(self.tendons), T.dtype)
        if not self.elastic:
            return tension(zero)
        none = jnp.zeros_like(T)
        unloaded = self.places.course(none, Vec(none, none, none)).length
        spans, soft = self.share * body.ds, self._softness(body, reference)

        def newton(P, T, curvature):
            strain = self.strain(P, T, curvature, body, reference)
            along, around, length = self.places.course(strain, curvature)
            lengths = jnp.sum(spans * (length - unloaded), axis=1)
            bent = jnp.sum(P[:, None] * self.share * around**2 / length, axis=0)
            compliance = (spans * along) @ (self.share * along * soft / (1.0 + soft * bent)).T
            value, slope = jax.jvp(tension, (lengths,), (jnp.ones_like(P),))
            matrix = jnp.eye(len(P), dtype=P.dtype) + slope[:, None] * compliance
            return P - jnp.linalg.solve(matrix, P - value)

        fixed = jax.lax.stop_gradient((T, curvature))
        steps = len(self.tendons) + 2
        found = jax.lax.fori_loop(0, steps, lambda _, P: newton(P, *fixed), zero)
        # The last step has the derivative of the solution.
        return newton(jax.lax.stop_gradient(found), T, curvature)


def tendon_lines(actuators: tuple[Actuator, ...], body: SpatialStructure) -> TendonLines | None:
    """Returns the lines of the tendons among the actuators, or None if there are no tendons."""
    tendons = tendons_of(actuators)
    if not tendons:
        return None
    rows = []
    for tendon in tendons:
        distance, share = tendon.place(body.s, body.ds)
        # Far outside its span, a line with a changing offset could reach the centre of curvature.
        offset = jnp.where(share > 0.0, tendon.offset_at(distance), 0.0)
        rate = tendon.angle_rate + 0.0 * distance
        rows.append((offset, tendon.angle_at(distance), rate, share))
    offset, angle, rate, share = (jnp.stack(x) for x in zip(*rows, strict=True))
    return TendonLines(tendons, Lines(offset, angle, rate), share)


def lines_of_chambers(
    space: SpaceSettings, spans: tuple[tuple[Scalar, Scalar], ...], body: SpatialStructure
) -> Lines | None:
    """Returns the lines of chambers with the `spans` [m] from the head; None without distances.

    The ends of a chamber are smeared over a few cells; outside its span, the
    angle is that of the end, and da/ds is that of the span.
    """
    if space.distances is None:
        return None
    near, far = jnp.asarray(spans, float).T[:, :, None]
    start = jnp.asarray(space.angles, float)
    end = start if space.far_angles is None else jnp.asarray(space.far_angles, float)
    rate = (end - start)[:, None] / (far - near)
    distance = body.s[-1] + 0.5 * body.ds[-1] - body.s
    angle = start[:, None] + rate * (jnp.clip(distance, near, far) - near)
    zero = jnp.zeros_like(angle)
    return Lines(jnp.asarray(space.distances, float)[:, None] + zero, angle, zero - rate)


def chamber_lines(
    places: Lines | None, pressure: Float[Array, " chambers"], K_Q: Float[Array, "chambers cells"]
) -> ChamberLines | None:
    """Returns chambers with given `pressure` [Pa]; `K_Q` [m^3] is the moment per unit pressure."""
    if places is None:
        return None
    side = jnp.where(pressure < 0.0, 1.0, -1.0)[:, None]
    return ChamberLines(replace(places, offset=side * places.offset), pressure[:, None] * K_Q)
