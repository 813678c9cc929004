"""The parts of a robot: body and tail, with properties that vary along them.

A part consists of pieces, from the head towards the tail's end. A property is one number for the
whole part, or it changes linearly along each piece. `cell_mean` averages a property over the cells
of a mesh, so the pieces need not end at nodes, and the number of pieces does not change the size of
the program.
"""

from dataclasses import replace
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

Scalar = Float[Array, ""] | float
Property = Float[Array, "pieces 2"] | Scalar
"""A number, or the values at the near end and at the far end of each piece."""


class RobotPart(eqx.Module):
    """A part of the robot, in SI units.

    | field | unit | meaning |
    |---|---|---|
    | `lengths` | m | length of the part, or the lengths of its pieces |
    | `linear_density` | kg/m | m, mass per length |
    | `EI` | N m^2 | bending stiffness |
    | `EA` | N | axial stiffness |
    | `damping_time` | s | alpha: stress = E_el (1 + alpha d/dt) strain, elastic modulus E_el |
    | `height` | m | H, out-of-plane height that determines the forces of the water |
    | `area` | m^2 | A, volume of displaced water per length; None: no buoyancy |

    A robot in three dimensions has further properties. The planar program ignores them.

    | field | unit | meaning |
    |---|---|---|
    | `GJ` | N m^2 | torsional stiffness |
    | `EI_n` | N m^2 | stiffness against bending out of the plane; None: `EI` |
    | `polar_inertia` | kg m | moment of inertia about the axis per length |
    | `width` | m | W, size of the section across the height; None: 0, a plate |
    """

    lengths: Float[Array, " pieces"] | Scalar
    linear_density: Property
    EI: Property
    EA: Property
    damping_time: Property
    height: Property
    area: Property | None = None
    GJ: Property | None = None
    EI_n: Property | None = None
    polar_inertia: Property | None = None
    width: Property | None = None

    COMPLIANT: ClassVar[tuple[str, ...]] = ("EI", "EA", "GJ", "EI_n")
    """Properties whose reciprocals are averaged: compliances in series add up."""

    @property
    def length(self) -> Scalar:
        """Length [m] of the part."""
        return jnp.sum(self.lengths) if jnp.ndim(self.lengths) else self.lengths

    @property
    def mass(self) -> Scalar:
        """Mass [kg] of the part."""
        return jnp.sum(self.lengths * _mean_of_ends(self.linear_density))

    @property
    def effective_EI(self) -> Scalar:
        """EI [N m^2] of a uniform part that bends as much under a uniform moment."""
        if jnp.ndim(self.EI) == 0:
            return self.EI
        near, far = jnp.asarray(self.EI).T
        # The mean of 1/EI is log(far/near)/(far - near), which is 2/(far + near) for equal ends.
        uniform = jnp.abs(far - near) < 1e-4 * near
        change = jnp.where(uniform, near, far - near)
        compliance = jnp.where(uniform, 2.0 / (far + near), jnp.log(far / near) / change)
        return self.length / jnp.sum(self.lengths * compliance)

    def changed(self, length: Scalar | None = None, EI: Scalar | None = None) -> "RobotPart":
        """Returns the part with another `length` [m] or another `effective_EI` [N m^2].

        Lengths and stiffnesses of the pieces keep their ratios.
        """
        part = self
        if length is not None:
            own = self.lengths * (length / self.length) if jnp.ndim(self.lengths) else length
            part = replace(part, lengths=own)
        if EI is not None:
            part = replace(part, EI=self.EI * (EI / self.effective_EI) if jnp.ndim(self.EI) else EI)
        return part

    def cell_mean(self, name: str, near: Float[Array, " cells"], far: Float[Array, " cells"]):
        """Returns the mean of a property in cells between the distances `near` and `far` [m].

        The distances are from the near end of the part. The mean is an integral over the cell, with
        the midpoint rule on each piece; its error is of second order in the cell's length.
        """
        values = getattr(self, name)
        if jnp.ndim(values) == 0:
            return values * jnp.ones_like(near)
        ends = jnp.cumsum(self.lengths)
        starts = ends - self.lengths
        begin = jnp.maximum(near[:, None], starts)
        end = jnp.minimum(far[:, None], ends)
        # The far end of the last cell equals the length of the part except for rounding.
        weight = jnp.maximum(end - begin, 0.0)
        share = jnp.clip((0.5 * (begin + end) - starts) / self.lengths, 0.0, 1.0)
        inside = values[:, 0] + share * (values[:, 1] - values[:, 0])
        if name in self.COMPLIANT:
            return jnp.sum(weight, 1) / jnp.sum(weight / inside, 1)
        return jnp.sum(weight * inside, 1) / jnp.sum(weight, 1)

    def at_nodes(self, name: str, place: Float[Array, " nodes"]):
        """Returns a property at the distances `place` [m] from the near end of the part.

        At a jump between two pieces, the result is the mean of both values.
        """
        values = getattr(self, name)
        if jnp.ndim(values) == 0:
            return values * jnp.ones_like(place)
        ends = jnp.cumsum(self.lengths)
        starts, last = ends - self.lengths, len(ends) - 1

        def from_piece(j):
            share = jnp.clip((place - starts[j]) / self.lengths[j], 0.0, 1.0)
            return values[j, 0] + share * (values[j, 1] - values[j, 0])

        tiny = 1e-9 * ends[-1]
        before = jnp.clip(jnp.searchsorted(ends, place - tiny), 0, last)
        after = jnp.clip(jnp.searchsorted(ends, place + tiny), 0, last)
        return 0.5 * (from_piece(before) + from_piece(after))


def _mean_of_ends(values: Property):
    return values if jnp.ndim(values) == 0 else jnp.mean(values, axis=-1)
