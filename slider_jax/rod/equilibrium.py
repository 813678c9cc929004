"""The equilibrium of a rod under static loads, and its stability.

Newton's method solves `rod_equations` at a growing share of the loads. The far end
of a rod may be held; the force and the moment of its support are then further unknowns, and the
place of the end gives the further equations. The shape is of fourth order in the length of the
cells if the properties vary smoothly.
"""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.linalg import eigvals, null_space

from slider_jax.errors import SolverError
from slider_jax.rod.ends import HeldEnd
from slider_jax.rod.loads import RodLoads, weighted_place
from slider_jax.rod.rod import Rod, RodShape, rod_shape
from slider_jax.rod.rotations import rotation
from slider_jax.rod.virtual_work import rod_equations, unloaded_tip

TOLERANCE = 1e-11
"""Largest relative error of the strains and of the end's place at which Newton's method stops."""
MOST_ITERATIONS = 30
"""Most Newton iterations at one share of the loads."""
LARGEST_STEP, SMALLEST_STEP = 0.25, 1e-3
"""Largest step of the share of the loads, and smallest step divided by the largest one."""
LARGEST_TURN = 0.125
"""Most turns of a held end in a step. From an eighth of a turn, Newton's method converges to the
next shape; after half a turn, the direction of the turn would be lost."""
NEUTRAL = 1e-9
"""Size of an eigenvalue below which the equilibrium is neutral. Rounding errors and `TOLERANCE`
cause errors of 1e-11 to 1e-10."""


class RodEquilibrium(NamedTuple):
    """An equilibrium of a rod."""

    strains: Float[Array, "points q"]
    shape: RodShape
    force: Float[Array, "3"]
    """Force [N] that the rod exerts on the support of the near end, in space."""
    moment: Float[Array, "3"]
    """Moment [N m] that the rod exerts on the support of the near end, in space."""
    residual: Float[Array, ""]
    """Largest of these errors: of a strain, divided by the largest strain or by 1/length; of the
    far end's turn; of its place, divided by the length; and of the moment in the near hinge,
    divided by the largest stiffness and the largest strain or 1/length."""
    ok: Bool[Array, ""]
    """Whether Newton's method converged."""
    end_force: Float[Array, "3"]
    """Force [N] that the support of the far end exerts on the rod; zero without a support."""
    end_moment: Float[Array, "3"]
    """Moment [N m] that the support of the far end exerts on the rod."""


class _State(NamedTuple):
    """The unknowns."""

    strains: Float[Array, "points q"]
    near: Float[Array, "3 3"]
    """Frame at the near end; it turns only in a hinge."""
    pull: Float[Array, " k"]
    """Force [N] and moment [N m] of the far support along the held axes."""


class _System(NamedTuple):
    """The equations at a state, and their derivatives with respect to strains and near turns."""

    error: Float[Array, " unknowns"]
    stiffness: Float[Array, "unknowns unknowns"]
    held: Float[Array, "k unknowns"]
    """Motions along the held axes of the far end per change of each unknown."""
    away: Float[Array, " k"]
    """Errors of the far end along the held axes."""


def _share_of(
    loads: RodLoads, rod: Rod, end: HeldEnd | None, share
) -> tuple[RodLoads, Rod, HeldEnd | None]:
    """Returns loads, rod and supports with a share of the loads and of the end's way."""
    tendons = tuple(replace(x, tension=share * x.tension) for x in loads.tendons)
    part = replace(loads, force=share * loads.force, moment=share * loads.moment, tendons=tendons)
    rod = replace(rod, weight=share * rod.weight)
    if end is None:
        return part, rod, None
    end = end.at(share)
    return part, replace(rod, initial_curvature=rod.initial_curvature + end.bow), end


def _system(x: _State, loads: RodLoads, rod: Rod, end: HeldEnd | None) -> _System:
    """Returns the equations of a rod with its supports."""
    if end is None:
        work = rod_equations(x.strains, rod, loads)
        none = jnp.zeros((0, x.strains.size))
        return _System(work.residual, work.stiffness, none, x.pull)
    force, moment = end.pull(x.pull)
    loads = replace(loads, force=loads.force + force, moment=loads.moment + moment)
    work = rod_equations(x.strains, replace(rod, clamp=x.near), loads)
    axes, tip = end.near_axes, work.shape.position[-1]
    spin = jnp.concatenate([work.spin, axes.T])
    moved = jnp.concatenate([work.tip, jnp.cross(axes.T, tip)])
    return _System(
        jnp.concatenate([work.residual, -axes.T @ work.moment]),
        jnp.block(
            [
                [work.stiffness, work.turned @ axes],
                [axes.T @ work.turning, axes.T @ work.turned_moment @ axes],
            ]
        ),
        jnp.concatenate([end.held @ moved.T, end.turning_held @ spin.T]),
        end.error(work.shape),
    )


_compiled_system = eqx.filter_jit(_system)


def _step(x: _State, system: _System, end: HeldEnd | None, matrix: _System) -> _State:
    """Returns the state after a Newton step with the derivatives of `matrix`."""
    held, stiffness = matrix.held, matrix.stiffness
    zero = jnp.zeros((len(held), len(held)))
    scale = jnp.max(jnp.abs(jnp.diag(stiffness)))
    whole = jnp.block([[stiffness, -scale * held.T], [-scale * held, zero]])
    errors = jnp.concatenate([system.error, -scale * system.away])
    change = -jnp.linalg.solve(whole, errors)
    size, unknowns = x.strains.size, len(system.error)
    near = x.near
    if end is not None:
        near = rotation(end.near_axes @ change[size:unknowns]) @ near
    return _State(
        x.strains + change[:size].reshape(x.strains.shape), near, x.pull + scale * change[unknowns:]
    )


@eqx.filter_jit
def _solve(
    guess: _State, rod: Rod, loads: RodLoads, end: HeldEnd | None, share
) -> tuple[_State, Bool[Array, ""]]:
    """Returns the equilibrium at a share of the loads, and whether Newton's method converged."""
    part = _share_of(loads, rod, end, share)

    def improve(state):
        x, _, count = state
        system = _system(x, *part)
        error = _error(x, system, rod, end)
        after = _step(x, system, part[2], system)
        # A step beyond the tolerance would only add rounding errors to a soft rod.
        return (
            jax.tree.map(lambda a, b: jnp.where(error > TOLERANCE, a, b), after, x),
            error,
            count + 1,
        )

    def unfinished(state):
        _, error, count = state
        return (error > TOLERANCE) & (count < MOST_ITERATIONS) & (error < jnp.inf)

    x, error, _ = jax.lax.while_loop(unfinished, improve, (guess, jnp.ones(()), 0))
    return x, error <= TOLERANCE


@eqx.filter_jit
def _found(
    x: _State, rod: Rod, loads: RodLoads, end: HeldEnd | None, ok: Bool[Array, ""]
) -> RodEquilibrium:
    """Returns the equilibrium of a state, with the derivatives of one more Newton step."""
    part = _share_of(loads, rod, end, 1.0)
    system = _system(x, *part)
    error = _error(x, system, rod, end)
    step = _step(x, system, part[2], jax.lax.stop_gradient(system))
    x = jax.tree.map(lambda a, b: a + (b - jax.lax.stop_gradient(b)), x, step)
    pull = (jnp.zeros(3), jnp.zeros(3)) if end is None else end.pull(x.pull)
    rod = replace(rod, clamp=x.near)
    shape = rod_shape(rod, x.strains)
    force, moment = loads.on_tip(shape.frame[-1], unloaded_tip(rod, loads))
    force, arm = force + pull[0], shape.position[-1]
    moment = moment + pull[1] + jnp.cross(arm, force)
    return RodEquilibrium(
        x.strains,
        shape,
        force + jnp.sum(rod.weight * rod.ds) * loads.down,
        moment + jnp.cross(weighted_place(rod, x.strains, shape), loads.down),
        error,
        ok & jnp.all(jnp.isfinite(x.strains)),
        *pull,
    )


@eqx.filter_jit
def equilibrium(
    rod: Rod, loads: RodLoads, increments: int, start: Float[Array, "points q"] | None = None
) -> RodEquilibrium:
    """Returns the equilibrium that is reached if the loads grow in `increments` equal steps.

    With `start`, the strains of a known equilibrium under similar loads, use one increment.
    The result is differentiable with respect to rod and loads (implicit
    function theorem), and may be batched with `jax.vmap`.
    """
    given = jax.lax.stop_gradient((rod, loads))
    begin = given[0].unloaded if start is None else jax.lax.stop_gradient(start)
    shares = jnp.arange(1, increments + 1) / increments
    x, ok = jax.lax.scan(
        lambda x, share: _solve(x, *given, None, share),
        _State(begin, given[0].clamp, jnp.zeros(0)),
        shares,
    )
    return _found(x, rod, loads, None, jnp.all(ok))


def _error(x: _State, system: _System, rod: Rod, end: HeldEnd | None) -> Float[Array, ""]:
    """Returns the largest relative error of a strain, of the far end, or of the near hinge.

    The error of the hinge is its moment, divided by the moment that bends the rod to the largest
    strain.
    """
    weights = (rod.elasticity * rod.ds[:, None]).ravel()
    length = jnp.sum(rod.ds)
    size = jnp.maximum(jnp.max(jnp.abs(x.strains)), 1.0 / length)
    strain = jnp.max(jnp.abs(system.error[: weights.size] / weights)) / size
    if end is None:
        return strain
    moved, turned = jnp.split(jnp.abs(system.away), [len(end.held)])
    away = jnp.max(moved, initial=0.0) / length
    moment = jnp.max(jnp.abs(system.error[weights.size :]), initial=0.0)
    hinge = moment / (jnp.max(rod.stiffness) * size)
    return jnp.max(jnp.stack([strain, away, jnp.max(turned, initial=0.0), hinge]))


def solve_equilibrium(rod: Rod, loads: RodLoads, end: HeldEnd | None = None) -> RodEquilibrium:
    """Returns the equilibrium that is reached if the loads grow, and the held end moves.

    A step is halved if Newton's method does not converge, or, with a held end, if a strain changes
    by more than the largest strain. Raises `SolverError` if the steps become too small.
    """
    begin, largest, pull = rod.unloaded, LARGEST_STEP, jnp.zeros(0)
    if end is not None:
        begin = begin.at[:, :3].add(end.bow)
        largest = min(largest, LARGEST_TURN / max(abs(float(end.turns)), 1e-9))
        pull = jnp.zeros(len(end.held) + len(end.turning_held))
    x = before = _State(begin, rod.clamp, pull)
    share, step, last = 0.0, largest, jnp.inf
    while share < 1.0:
        step = min(step, 1.0 - share)
        ahead = jax.tree.map(lambda a, b, f=step / last: a + f * (a - b), x, before)
        after, ok = _solve(ahead._replace(near=x.near), rod, loads, end, jnp.asarray(share + step))
        if end is not None:
            change = jnp.max(jnp.abs(after.strains - x.strains))
            ok = ok & (change < jnp.maximum(jnp.max(jnp.abs(x.strains)), 1.0 / jnp.sum(rod.ds)))
        if ok:
            x, before, last = after, x, step
            share = share + step if share + step < 1.0 - 1e-12 else 1.0
            step = min(2.0 * step, largest)
        else:
            step = 0.5 * step
            if step < SMALLEST_STEP * largest:
                break
    if share == 1.0:
        found = _found(x, rod, loads, end, jnp.array(True))
        if found.ok:
            return found
    if end is not None and share == 0.0:
        held = _compiled_system(x, *_share_of(loads, rod, end, 0.0)).held[:, x.strains.size :]
        if np.linalg.matrix_rank(held, tol=NEUTRAL * float(jnp.sum(rod.ds))) < held.shape[1]:
            raise SolverError(
                "the supports let the rod turn or slide as a rigid body, so its shape is not "
                "determined; clamp one end, or remove end.slides_along"
            )
    if end is None:
        remedy = "reduce the loads"
    else:
        remedy = "reduce the loads, or move or turn the held end less"
    raise SolverError(
        f"the equilibrium of the rod was not found beyond {100.0 * share:.3g} % of the loads; the "
        f"rod may jump to another shape there: {remedy}"
    )


def smallest_eigenvalue(
    found: RodEquilibrium, rod: Rod, loads: RodLoads, end: HeldEnd | None = None
) -> float:
    """Returns the smallest real part of the eigenvalues of the stiffness matrix.

    The matrix is divided by the stiffness of the unloaded rod, so the value is 1 without loads. A
    turn of a hinged near end counts with the stiffness EI/length; the value is then less than 1.
    The matrix acts on the motions that the supports allow. The equilibrium is stable against small
    static disturbances if the value is positive. It is neutral if the value is zero, to `NEUTRAL`:
    the rod then moves without force, like an isotropic rod between two clamps in line. The
    criterion does not find flutter under follower loads.
    """
    pull = jnp.zeros(0)
    if end is not None:
        pull = jnp.concatenate([end.held @ found.end_force, end.turning_held @ found.end_moment])
    x = _State(found.strains, found.shape.frame[0], pull)
    system = _compiled_system(x, loads, rod, end)
    matrix, weights = np.asarray(system.stiffness), np.zeros(len(system.error))
    weights[: x.strains.size] = np.asarray(rod.elasticity * rod.ds[:, None]).ravel()
    weights[x.strains.size :] = (
        np.sum(rod.stiffness[:, 1:] * rod.ds[:, None]) / jnp.sum(rod.ds) ** 2
    )
    if end is None:
        return float(eigvals(matrix / weights[:, None]).real.min())
    free = null_space(np.asarray(system.held))
    lower = np.linalg.inv(np.linalg.cholesky(free.T @ (weights[:, None] * free)))
    return float(eigvals(lower @ (free.T @ matrix @ free) @ lower.T).real.min())
