"""The equations of a rod under static loads, from the principle of virtual work.

The unknowns are the strains q at the points. Each gives one equation:

    d(elastic energy + potential of weight and tendons)/dq = F . d(tip)/dq + M . d(turn of tip)/dq

F and M are the force and the moment on the tip. A change of a strain deforms its cell, and moves
the rest of the rod as a rigid body. So the matrix of the derivatives of the equations consists of
one block for each cell and products of three-vectors for each pair of cells.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.rod.loads import RodLoads, weighted_place
from slider_jax.rod.rod import Rod, RodShape, cell_motions, rod_shape
from slider_jax.rod.rotations import axis_of


class RodEquations(NamedTuple):
    """The equations at given strains. An unknown i * q + j is strain j of point i."""

    shape: RodShape
    residual: Float[Array, " unknowns"]
    """Left side minus right side of the equations."""
    moment: Float[Array, "3"]
    """Moment [N m] of all loads about the near end."""
    spin: Float[Array, "unknowns 3"]
    """Turn of the tip per change of each unknown."""
    tip: Float[Array, "unknowns 3"]
    """Displacement of the tip per change of each unknown."""
    stiffness: Float[Array, "unknowns unknowns"]
    """Derivative of `residual`, without the turns of the near end."""
    turning: Float[Array, "3 unknowns"]
    """Derivative of minus `moment` with respect to the unknowns."""
    turned: Float[Array, "unknowns 3"]
    """Derivative of `residual` with respect to turns of the near end."""
    turned_moment: Float[Array, "3 3"]
    """Derivative of minus `moment` with respect to turns of the near end."""


def _by_cell(rod: Rod, loads: RodLoads):
    """Returns the rod and the tendons of each cell, with the cells along the first axis."""

    def pairs(x):
        return x.reshape(-1, 2, *x.shape[1:])

    cells = len(rod.ds) // 2
    each = Rod(
        pairs(rod.ds), pairs(rod.stiffness), pairs(rod.initial_curvature),
        jnp.broadcast_to(jnp.eye(3), (cells, 3, 3)), pairs(rod.weight),
        None if rod.EA is None else pairs(rod.EA),
    )  # fmt: skip
    tendons = tuple(
        type(x)(
            pairs(x.offset), pairs(x.offset_slope), pairs(x.share),
            jnp.broadcast_to(x.tension, (cells,)),
        )
        for x in loads.tendons
    )  # fmt: skip
    return each, tendons


def _own_place(strains, rod: Rod, turning, ahead):
    """Returns the weighted place of a cell in the frame at its near end."""
    ends = jnp.stack([jnp.zeros(3), ahead])
    return weighted_place(rod, strains, RodShape(ends, jnp.stack([jnp.eye(3), turning])))


def _work_in_cell(strains, rod: Rod, tendons, force, moment, down):
    """Returns the residual of a cell under force and moment on its far end, and its motions.

    The motions are derivatives of the far end's place, its turn and the weighted place with
    respect to the strains. All vectors are in the frame at the near end of the cell.
    """

    def state(q):
        turning, ahead = (x[0] for x in cell_motions(rod, q))
        energy = 0.5 * jnp.sum(rod.elasticity * (q - rod.unloaded) ** 2 * rod.ds[:, None])
        for tendon in tendons:
            energy = energy + tendon.tension * tendon.length(rod, q)
        place = _own_place(q, rod, turning, ahead)
        return (energy, ahead, turning, place), turning

    (energy, far, turning, place), frame = jax.jacfwd(state, has_aux=True)(strains)
    n = strains.size
    spin = axis_of(jnp.einsum("ijk,lj->kil", turning.reshape(3, 3, n), frame))
    motions = far.reshape(3, n).T, spin, place.reshape(3, n).T
    work = energy.reshape(n) - motions[0] @ force - spin @ moment - motions[2] @ down
    return work, (work, motions)


def _beyond(x):
    """Returns the sum over all later cells."""
    return jnp.flip(jnp.cumsum(jnp.flip(x, 0), 0), 0) - x


def unloaded_tip(rod: Rod, loads: RodLoads) -> Float[Array, "3 3"]:
    """Returns the frame of the tip of the unloaded rod; it matters for follower loads only."""
    return rod_shape(rod, rod.unloaded).frame[-1] if loads.follower else rod.clamp


def rod_equations(strains: Float[Array, "points q"], rod: Rod, loads: RodLoads) -> RodEquations:
    """Returns the equations of a rod, and their derivatives."""
    shape = rod_shape(rod, strains)
    force, moment = loads.on_tip(shape.frame[-1], unloaded_tip(rod, loads))
    parts, down = _by_cell(rod, loads), loads.down
    pairs = strains.reshape(-1, 2, strains.shape[1])
    cells, size = len(pairs), 2 * strains.shape[1]
    near, far, tip = shape.frame[:-1], shape.position[1:], shape.position[-1]

    # Loads beyond each cell: force, and moment about the far end of the cell.
    weight = jnp.sum(parts[0].weight * parts[0].ds, axis=1)
    own = jax.vmap(_own_place)(pairs, parts[0], *cell_motions(rod, strains))
    place = jnp.einsum("cij,cj->ci", near, own) + weight[:, None] * shape.position[:-1]
    later, lever = _beyond(weight), _beyond(place)
    forces = force + later[:, None] * down
    arms = jnp.einsum("ci,j->cij", tip - far, force)
    arms = arms + jnp.einsum("ci,j->cij", lever - later[:, None] * far, down)
    moments = moment + 2.0 * axis_of(jnp.swapaxes(arms, 1, 2))

    def local(v):
        return jnp.einsum("cij,ci->cj", near, v)

    given = local(forces), local(moments), local(jnp.broadcast_to(down, (cells, 3)))
    slopes = jax.vmap(jax.jacfwd(_work_in_cell, has_aux=True))
    block, (residual, motions) = slopes(pairs, *parts, *given)
    block = block.reshape(cells, size, size)

    # Motions per unknown, in space; `drag` is the change of the moment of the loads beyond.
    moved, spin, shifted = (jnp.einsum("cij,cuj->cui", near, x) for x in motions)
    swing = arms - jnp.einsum("cii->c", arms)[:, None, None] * jnp.eye(3)
    swung = jnp.einsum("cij,cuj->cui", swing, spin)
    drag = swung + jnp.cross(moved, forces[:, None]) + jnp.cross(shifted, down)
    block = block - jnp.einsum("cui,cvi->cuv", spin, swung)
    carried = moved + jnp.cross(spin, (tip - far)[:, None])
    spin, drag, carried = (x.reshape(-1, 3) for x in (spin, drag, carried))
    after = drag + jnp.cross(spin, moment)
    cell = jnp.arange(cells * size) // size
    stiffness = jnp.where(cell[:, None] < cell, -spin @ drag.T, -after @ spin.T)
    stiffness = stiffness.reshape(cells, size, cells, size)
    each = jnp.arange(cells)
    stiffness = stiffness.at[each, :, each, :].set(block).reshape(cells * size, -1)
    if loads.follower:
        stiffness = stiffness - carried @ jnp.cross(spin, force).T
        stiffness = stiffness - spin @ jnp.cross(spin, moment).T
    swing = jnp.outer(tip, force) + jnp.outer(jnp.sum(place, axis=0), down)
    return RodEquations(
        shape,
        residual.ravel(),
        moment + 2.0 * axis_of(swing.T),
        spin,
        carried,
        stiffness,
        -drag.T,
        -after,
        jnp.trace(swing) * jnp.eye(3) - swing,
    )
