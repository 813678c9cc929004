"""The equations of one implicit stage, stacked: cells, tail, head. Knows no solver."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam import Reference, Structure, equations, section
from slider_jax.effects import ForceDensity, total_force
from slider_jax.linear import BeamOperator
from slider_jax.state import Fields, Unknowns, fields
from slider_jax.supports import Support


class Stage(eqx.Module):
    """Everything that one implicit stage holds fixed while its unknowns are sought."""

    structure: Structure
    effects: tuple[ForceDensity, ...]
    support: Support
    reference: Reference
    phi_head_reference: Array
    active_moment: Float[Array, " cells"]
    water: Float[Array, "2"]
    t: Array


def cell_rows(mid: Fields, slope: Fields, stage: Stage) -> tuple[Array, ...]:
    """The six equations of every cell, from the unknowns' means and slopes in it."""
    x = section(mid, slope, stage.structure, stage.reference, stage.water, stage.t)
    force = total_force(stage.effects, x)
    return equations(mid, slope, x, stage.structure, force, stage.active_moment)


def turning_rate(head: Fields, stage: Stage) -> Array:
    """omega [rad/s] of the head."""
    return (head.phi - stage.phi_head_reference) / stage.reference.dt


def head_rows(head: Float[Array, "6"], stage: Stage) -> Float[Array, "3"]:
    """The support's three rows."""
    at_head = fields(head)
    return jnp.stack(stage.support.rows(at_head, turning_rate(at_head, stage), stage.t))


def tail_rows(tail: Float[Array, "6"]) -> Float[Array, "3"]:
    """A free end: T = N = M = 0."""
    return tail[:3]


def mid_and_slope(y: Unknowns, ds) -> tuple[Fields, Fields]:
    """Means and slopes of the six unknowns in each cell."""
    left, right = y[:, :-1], y[:, 1:]
    return fields(0.5 * (left + right)), fields((right - left) / ds)


def residual(y: Unknowns, stage: Stage):
    """Zero at the solution. Returns ((6, cells), (3,), (3,)): cells, tail, head."""
    mid, slope = mid_and_slope(y, stage.structure.ds)
    return jnp.stack(cell_rows(mid, slope, stage)), tail_rows(y[:, 0]), head_rows(y[:, -1], stage)


def jacobian(y: Unknowns, stage: Stage) -> BeamOperator:
    """d(residual)/dy by blocks.

    A cell's rows depend on 12 cell values, the means and slopes of six unknowns, elementwise along
    the body. Twelve forward tangents, each in one of them alone, give all blocks of all cells.
    """
    mid, slope = mid_and_slope(y, stage.structure.ds)
    values = (*mid, *slope)

    def derivative(i):
        def rows(v):
            moved = (*values[:i], v, *values[i + 1 :])
            return cell_rows(Fields(*moved[:6]), Fields(*moved[6:]), stage)

        _, tangent = jax.jvp(rows, (values[i],), (jnp.ones_like(values[i]),))
        return jnp.stack(tangent)

    to_mid = 0.5 * jnp.stack([derivative(i) for i in range(6)], axis=1)
    to_slope = jnp.stack([derivative(i) for i in range(6, 12)], axis=1) / stage.structure.ds
    return BeamOperator(
        left=to_mid - to_slope,
        right=to_mid + to_slope,
        tail=jax.jacfwd(tail_rows)(y[:, 0]),
        head=jax.jacfwd(head_rows)(y[:, -1], stage),
    )
