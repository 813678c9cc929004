"""Shapes at rest: a clamped robot under pressures and a dead load on the tail's end."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float

from slider_jax.beam import Reference
from slider_jax.effects import BendingMoment, of_place
from slider_jax.frame import midline, to_body
from slider_jax.linear import BeamOperator
from slider_jax.model import Mesh, Model, make_mesh
from slider_jax.newton import BeamAdjoint, BeamNewton
from slider_jax.parameters import Numerics, Scalar, scales_of
from slider_jax.pneumatics import start_chambers
from slider_jax.residual import Stage, jacobian, residual
from slider_jax.state import Memory, Unknowns, straight
from slider_jax.step import Carry, start

LONG = 1e9
"""Time [s] over which a static state is reached: rates of what is finite vanish."""
INCREMENTS = 8
"""Parts in which load and pressure are applied: each shape is the next one's first guess."""
MOST_NEWTON = 30


class Loads(NamedTuple):
    """What bends a robot at rest."""

    force: Float[Array, "2"]
    """(x, y) [N] on the tail's end; it keeps its direction."""
    pressure: Float[Array, "2"]
    """Front and rear chamber [Pa]."""


class AtRest(NamedTuple):
    """A static state."""

    y: Unknowns
    """Forces, moment and angle at the nodes; the velocities are zero but for 1/`LONG`."""
    shape: Float[Array, "2 nodes"]
    """(x, y) [m] from the head, tail first."""
    ok: Bool[Array, ""]
    """Whether every root find converged."""


def at_rest_under(model: Model, loads: Loads, numerics: Numerics = Numerics()) -> AtRest:
    """The static shape of `model` under `loads`, its head clamped, its water and drive left out.

    Differentiable with respect to every number, by the implicit function theorem.
    """
    mesh = make_mesh(model.body, numerics)
    stage = _stage(model, mesh)
    straight_y, _ = straight(mesh.grid.s)
    options = {
        "jacobian": _loaded_jacobian,
        "scale": scales_of(model.body),
        "skip": jnp.asarray(False),
    }

    def increment(y, share):
        moment = share * loads.pressure @ mesh.chambers
        loaded = eqx.tree_at(lambda s: s.active_moment, stage, moment)
        found = optx.root_find(
            _loaded,
            BeamNewton(rtol=numerics.tolerance),
            y,
            args=(loaded, share * loads.force),
            options=options,
            max_steps=MOST_NEWTON,
            adjoint=BeamAdjoint(),
            throw=False,
        )
        return found.value, found.result == optx.RESULTS.successful

    shares = jnp.arange(1.0, INCREMENTS + 1.0) / INCREMENTS
    y, ok = jax.lax.scan(increment, straight_y, shares)
    eps = mesh.grid.mid(y[0]) / mesh.structure.EA
    return AtRest(y, midline(y[5], eps, jnp.zeros(2), mesh.grid), jnp.all(ok))


def release(model: Model, begin: AtRest, numerics: Numerics = Numerics()) -> Carry:
    """The carry that begins a rollout at a static state, its tip load gone at that instant."""
    mesh = make_mesh(model.body, numerics)
    y = begin.y.at[3:5].set(0.0)
    eps = mesh.grid.mid(y[0]) / mesh.structure.EA
    internal = tuple(jnp.zeros_like(eps) for _ in of_place(model.effects, BendingMoment))
    memory = Memory(y[3:], eps, jnp.zeros(2), y[:3, -1], internal)
    return start(y, memory, start_chambers(model))


def _stage(model: Model, mesh: Mesh) -> Stage:
    zero = jnp.zeros_like(mesh.grid.ds)
    internal = tuple(zero for _ in of_place(model.effects, BendingMoment))
    reference = Reference(zero, zero, zero, zero, zero, internal, jnp.asarray(LONG))
    return Stage(
        structure=mesh.structure,
        effects=model.effects,
        support=model.support,
        reference=reference,
        phi_head=jnp.asarray(0.0),
        load_head=jnp.zeros(3),
        active_moment=zero,
        water=jnp.zeros((2, 2)),
        t=jnp.asarray(0.0),
    )


def _tail_load(phi: Scalar, force: Float[Array, "2"]) -> Float[Array, "3"]:
    """T, N, M that the tail's end carries under a force (x, y) [N]."""
    T, N = to_body((-force[0], -force[1]), phi)
    return jnp.stack([T, N, jnp.zeros_like(T)])


def _loaded(y: Unknowns, args: tuple[Stage, Array]):
    """`residual` with a loaded tail's end."""
    stage, force = args
    cells, tail, head = residual(y, stage)
    return cells, tail - _tail_load(y[5, 0], force), head


def _loaded_jacobian(y: Unknowns, args: tuple[Stage, Array]) -> BeamOperator:
    stage, force = args
    operator = jacobian(y, stage)
    turning = jax.jacfwd(_tail_load)(y[5, 0], force)
    return eqx.tree_at(lambda a: a.tail, operator, operator.tail.at[:, 5].add(-turning))
