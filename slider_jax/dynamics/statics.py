"""Static shapes of a clamped robot under chamber pressures and a constant force on the tail end."""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from slider_jax.beam.equations import Reference
from slider_jax.beam.parameters import Numerics, Scalar, scales_of
from slider_jax.beam.state import Memory, Unknowns, node_positions, to_body
from slider_jax.dynamics.block_solver import BeamOperator, BeamSolver
from slider_jax.dynamics.model import Mesh, Model, make_mesh
from slider_jax.dynamics.newton import tangent_of
from slider_jax.dynamics.pressures import start_chambers
from slider_jax.dynamics.residual import Stage, at_cells, jacobian, residual
from slider_jax.dynamics.shapes import Shape, has_shape, shape_at
from slider_jax.dynamics.step import Carry, initial_carry
from slider_jax.effects import states_at_rest
from slider_jax.errors import InputError

LONG = 1e9
"""Value of dt [s] in a static stage, so large that rates (value - reference)/dt vanish."""
INCREMENTS = 8
"""Number of load increments; each static shape is the initial guess for the next increment."""
CORRECTIONS, LAST = 3, 4
"""Newton steps per load increment, and additional Newton steps at the full load."""


class Loads(NamedTuple):
    """The static loads of a robot."""

    force: Float[Array, "2"]
    """Force (x, y) [N] on the tail end, with a constant direction."""
    pressure: Float[Array, " chambers"]
    """Pressure [Pa] of each chamber."""


class AtRest(NamedTuple):
    """A static state."""

    y: Unknowns
    """Unknowns at the nodes; the velocities are of order 1/`LONG`."""
    shape: Float[Array, "2 nodes"]
    """Node positions (x, y) [m] relative to the head, tail first."""
    ok: Bool[Array, ""]
    """Whether the Newton iteration converged."""
    strain: Float[Array, " cells"]
    """Strain eps [-] in the cells."""


def at_rest_under(
    model: Model, loads: Loads, numerics: Numerics = Numerics(), t: Scalar = 0.0
) -> AtRest:
    """Returns the static state of a clamped `model` under `loads` in still water.

    The drive of the model is ignored. Its actuators keep their commands of the time `t` [s]. All
    numbers in `model` and `loads` are differentiable.
    """
    if model.waterline is not None:
        raise InputError(
            "waterline: given a surface of the water; allowed nothing, because static shapes are "
            "computed for a robot that is wholly in water or in air; simulate its motion instead"
        )
    mesh = make_mesh(model.body, numerics)
    zero = jnp.zeros_like(mesh.grid.ds)
    internal = states_at_rest(model.effects, zero)
    stage = Stage(
        structure=mesh.under(loads.pressure),
        effects=model.effects,
        support=model.support,
        reference=Reference(
            *(zero,) * 5, internal, jnp.asarray(LONG), lag=mesh.structure.damping_time / LONG
        ),
        phi_head=jnp.asarray(0.0),
        load_head=jnp.zeros(3),
        pressure=loads.pressure @ mesh.windows,
        active_moment=loads.pressure @ mesh.chambers,
        water=None,
        t=jnp.asarray(t, float),
        actuators=model.actuators,
        level=jnp.asarray(1.0) if model.actuators else None,
        shape=_shape(model, mesh, t),
    )
    y, error = _equilibrium((stage, loads.force, scales_of(model.body)))
    eps = at_cells(y, stage).strain if model.actuators else mesh.grid.mid(y[0]) / mesh.structure.EA
    shape = node_positions(y[5], eps, jnp.zeros(2), mesh.grid)
    return AtRest(y, shape, error < numerics.tolerance, eps)


def _shape(model: Model, mesh: Mesh, t: Scalar) -> Shape | None:
    """Returns the rate that gives the prescribed curvature after the time `LONG`."""
    if not has_shape(model.actuators):
        return None
    shape, kappa = shape_at(model.actuators, mesh.structure, jnp.asarray(t, float))
    return replace(shape, rate=kappa / LONG)


def _share_of(stage: Stage, share: Array) -> Stage:
    """Returns the stage with a share of its active loads."""
    part = replace(stage, active_moment=share * stage.active_moment)
    if stage.shape is not None:
        part = replace(part, shape=replace(stage.shape, rate=share * stage.shape.rate))
    return part if stage.level is None else replace(part, level=share * stage.level)


def release(model: Model, begin: AtRest, numerics: Numerics = Numerics()) -> Carry:
    """Returns the carry that starts a rollout from the state `begin` when the tip is released."""
    y = begin.y.at[3:5].set(0.0)
    eps = begin.strain
    internal = states_at_rest(model.effects, eps)
    memory = Memory(y[3:], eps, jnp.zeros(2), y[:3, -1], internal)
    return initial_carry(y, memory, start_chambers(model))


def _tail_load(phi: Scalar, force: Float[Array, "2"]) -> Float[Array, "3"]:
    """Returns (T, N, M) at the tail end under a force (x, y) [N]."""
    T, N = to_body((-force[0], -force[1]), phi)
    return jnp.stack([T, N, jnp.zeros_like(T)])


def _loaded(y: Unknowns, stage: Stage, force: Float[Array, "2"]):
    """Returns `residual` with a force on the tail end."""
    cells, tail, head = residual(y, stage)
    return cells, tail - _tail_load(y[5, 0], force), head


def _loaded_jacobian(y: Unknowns, stage: Stage, force: Float[Array, "2"]) -> BeamOperator:
    operator = jacobian(y, stage)
    turning = jax.jacfwd(_tail_load)(y[5, 0], force)
    return eqx.tree_at(lambda a: a.tail, operator, operator.tail.at[:, 5].add(-turning))


def _newton(stage: Stage, force: Float[Array, "2"], scale: Float[Array, "6 1"]):
    """Returns the state, its last relative change, and the factors of the last Jacobian."""
    solver = BeamSolver()

    def correct(carry, share):
        y = carry[0]
        part = _share_of(stage, share)
        factors = solver.init(_loaded_jacobian(y, part, share * force), {})
        change, _, _ = solver.compute(factors, _loaded(y, part, share * force), {})
        error = jnp.max(jnp.abs(change) / jnp.maximum(scale, jnp.abs(y)))
        return (y - change, error, factors[0]), None

    parts = np.repeat(np.arange(1.0, INCREMENTS + 1.0) / INCREMENTS, CORRECTIONS)
    shares = jnp.asarray(np.concatenate([parts, np.ones(LAST)]))
    y, infinite = jnp.zeros((6, stage.structure.ds.shape[-1] + 1)), jnp.asarray(jnp.inf)
    shapes = jax.eval_shape(lambda y: correct((y, infinite, None), shares[0])[0][2], y)
    factors = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
    return jax.lax.scan(correct, (y, infinite, factors), shares)[0]


@eqx.filter_custom_jvp
def _equilibrium(inputs):
    """Returns the static state and its last relative change; inputs: (stage, force, scale)."""
    return _newton(*inputs)[:2]


@_equilibrium.def_jvp
def _equilibrium_jvp(primals, tangents):
    """Returns dy = -J^-1 d(residual), with the factors of the last Newton step."""
    ((stage, force, scale),), (t_inputs,) = primals, tangents
    y, error, factors = _newton(stage, force, scale)
    t_value = tangent_of(lambda x: _loaded(y, *x), (stage, force), t_inputs[:2])
    t_y, _, _ = BeamSolver().compute((factors, False), t_value, {})
    return (y, error), (-t_y, jnp.zeros_like(error))
