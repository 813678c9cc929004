"""The equilibrium of a rod under static loads, and its stability.

The unknowns are the strains q of the cells: three curvatures and, if EA is given, the axial strain.
The principle of virtual work gives one equation for each unknown:

    d(elastic energy + potential of weight and tendons)/dq = F . d(tip)/dq + M . d(turn of tip)/dq

F and M are the force and the moment on the tip. The elastic energy of a cell of length ds is
ds/2 sum (stiffness (q - q_0)^2). The discretisation is of second order in ds. Newton's method with
a dense Jacobian solves the equations at growing shares of the loads.
"""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float

from slider_jax.errors import SolverError
from slider_jax.rod.loads import RodLoads
from slider_jax.rod.rod import Rod, RodShape, rod_shape
from slider_jax.rod.rotations import cross_matrix

TOLERANCE = 1e-10
"""Largest relative error of the strains at which Newton's method stops."""
MOST_ITERATIONS = 30
"""Most Newton iterations at one share of the loads."""
SHARES = (4, 16, 64, 256)
"""Numbers of equal load increments that `solve_equilibrium` tries one after the other."""


class RodEquilibrium(NamedTuple):
    """An equilibrium of a rod."""

    strains: Float[Array, "cells q"]
    shape: RodShape
    force: Float[Array, "3"]
    """Force [N] that the loads exert on the clamp, in space."""
    moment: Float[Array, "3"]
    """Moment [N m] that the loads exert on the clamp, in space."""
    residual: Float[Array, ""]
    """Largest error of a strain, divided by the largest strain or by 1/length."""
    ok: Bool[Array, ""]
    """Whether Newton's method converged."""


def virtual_work(
    strains: Float[Array, "cells q"], rod: Rod, loads: RodLoads
) -> Float[Array, "cells q"]:
    """Returns the residual of the equations as an error of each strain."""

    def energy_and_tip(q):
        shape = rod_shape(rod, q)
        elastic = 0.5 * jnp.sum(rod.elasticity * (q - rod.unloaded) ** 2 * rod.ds[:, None])
        energy = elastic + loads.potential(rod, q, shape)
        return energy, shape.position[-1], shape.frame[-1]

    (energy, _, frame), work_of = jax.vjp(energy_and_tip, strains)
    force, moment = loads.on_tip(frame, _unloaded_tip(rod, loads))
    # M . (small turn) = <cross_matrix(M), d(frame) frame^T>/2.
    turning = 0.5 * cross_matrix(moment) @ frame
    (work,) = work_of((jnp.ones_like(energy), -force, -turning))
    return work / (rod.elasticity * rod.ds[:, None])


def _unloaded_tip(rod: Rod, loads: RodLoads) -> Float[Array, "3 3"]:
    """Returns the frame of the tip of the unloaded rod; it matters for follower loads only."""
    return rod_shape(rod, rod.unloaded).frame[-1] if loads.follower else rod.clamp


def _share_of(loads: RodLoads, rod: Rod, share) -> tuple[RodLoads, Rod]:
    """Returns loads and rod with a share of force, moment, tensions and weight."""
    tendons = tuple(replace(x, tension=share * x.tension) for x in loads.tendons)
    part = replace(loads, force=share * loads.force, moment=share * loads.moment, tendons=tendons)
    return part, replace(rod, weight=share * rod.weight)


@eqx.filter_jit
def equilibrium(
    rod: Rod, loads: RodLoads, increments: int, start: Float[Array, "cells q"] | None = None
) -> RodEquilibrium:
    """Returns the equilibrium that is reached if the loads grow in `increments` equal steps.

    With `start`, the strains of a known equilibrium under similar loads, use one increment.
    The result is differentiable with respect to rod and loads (implicit
    function theorem), and may be batched with `jax.vmap`.
    """
    solver: optx.Newton = optx.Newton(rtol=TOLERANCE, atol=TOLERANCE)

    def solve(guess, share):
        part, weighted = _share_of(loads, rod, share)
        found = optx.root_find(
            lambda q, args: virtual_work(q, *args),
            solver,
            jax.lax.stop_gradient(guess),
            args=(weighted, part),
            max_steps=MOST_ITERATIONS,
            throw=False,
        )
        return found.value, found.result == optx.RESULTS.successful

    shares = jnp.arange(1, increments + 1) / increments
    begin = rod.unloaded if start is None else start
    strains, converged = jax.lax.scan(solve, begin, shares)
    shape = rod_shape(rod, strains)
    force, moment = loads.on_tip(shape.frame[-1], _unloaded_tip(rod, loads))
    middle = 0.5 * (shape.position[1:] + shape.position[:-1])
    weights = (rod.weight * rod.ds)[:, None] * loads.down
    size = jnp.maximum(jnp.max(jnp.abs(strains)), 1.0 / jnp.sum(rod.ds))
    error = jnp.max(jnp.abs(virtual_work(strains, rod, loads))) / size
    return RodEquilibrium(
        strains,
        shape,
        force + jnp.sum(weights, axis=0),
        moment + jnp.cross(shape.position[-1], force) + jnp.sum(jnp.cross(middle, weights), axis=0),
        error,
        jnp.all(converged) & jnp.all(jnp.isfinite(strains)),
    )


def solve_equilibrium(rod: Rod, loads: RodLoads) -> RodEquilibrium:
    """Returns the equilibrium, with as few load increments as converge.

    Raises `SolverError` if Newton's method does not converge even with the most increments.
    """
    for increments in SHARES:
        found = equilibrium(rod, loads, increments)
        if found.ok:
            return found
    raise SolverError(
        f"the equilibrium of the rod was not found with {SHARES[-1]} load increments; the rod may "
        "jump to another shape at a smaller load: reduce the loads"
    )


def stiffness_matrix(
    strains: Float[Array, "cells q"], rod: Rod, loads: RodLoads
) -> Float[Array, "m m"]:
    """Returns the derivative of `virtual_work` with respect to the strains, as a matrix.

    The matrix is divided by the stiffness of the unloaded rod: without loads, it is the unit
    matrix. Row and column i * q + j belong to strain j of cell i.
    """
    size = strains.size
    tangent = jax.jacfwd(virtual_work)(strains, rod, loads)
    return tangent.reshape(size, size)


def smallest_eigenvalue(strains: Float[Array, "cells q"], rod: Rod, loads: RodLoads) -> float:
    """Returns the smallest real part of the eigenvalues of the stiffness matrix.

    It is 1 without loads. The equilibrium is stable against small static
    disturbances if the value is positive. The criterion does not find flutter under follower loads.
    """
    matrix = np.asarray(eqx.filter_jit(stiffness_matrix)(strains, rod, loads))
    return float(np.linalg.eigvals(matrix).real.min())
