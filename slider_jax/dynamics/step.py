"""Makes one time step. In each stage, Newton's method solves the implicit equations."""

import functools as ft
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, PyTree

from slider_jax.beam.equations import Reference, Section, strain
from slider_jax.beam.parameters import Numerics, Scalar, grid_of, scales_of
from slider_jax.beam.state import (
    Memory,
    Unknowns,
    curved_state,
    fields,
    node_positions,
    straight_state,
    to_body,
    to_plane,
)
from slider_jax.dynamics.model import Mesh, Model, make_mesh
from slider_jax.dynamics.newton import BeamNewton
from slider_jax.dynamics.pressures import Chambers, start_chambers
from slider_jax.dynamics.residual import (
    Stage,
    at_cells,
    forces_and_states,
    jacobian,
    load_rates,
    on_support,
    residual,
)
from slider_jax.dynamics.shapes import has_shape, shape_at, shape_in_step
from slider_jax.dynamics.time_schemes import KNOWN, Scheme, extrapolation
from slider_jax.effects import states_at_rest
from slider_jax.supports import Support


class Carry(eqx.Module):
    """The state that one step passes to the next step."""

    history: Float[Array, "4 6 nodes"]
    """The last solutions, oldest first, which predict the next solution."""
    memory: Memory
    chambers: Chambers
    ok: Bool[Array, ""]
    """False after a stage did not converge; from this stage on, the state remains frozen."""
    factorisations: Array
    """Number of factorisations of the Jacobian so far."""
    failed_at: Array
    """Time [s] of the failed stage; inf if no stage failed."""


class Snapshot(eqx.Module):
    """The system at the end of a step, from which observables are computed."""

    t: Array
    y: Unknowns
    memory: Memory
    stage: Stage
    mesh: Mesh
    chambers: Chambers

    @property
    def head(self) -> Float[Array, "2"]:
        """Position (x, y) [m] of the head."""
        return self.memory.head

    def section(self) -> Section:
        """Returns the local state of the body in each cell."""
        return at_cells(self.y, self.stage)

    def positions(self) -> Float[Array, "2 nodes"]:
        """Returns the positions (x, y) [m] of the nodes, tail first."""
        return node_positions(self.y[5], self.memory.strain, self.head, self.mesh.grid)

    def directions(self) -> Float[Array, "2 nodes"]:
        """Returns the unit vectors tau (x, y) at the nodes."""
        return jnp.stack([jnp.cos(self.y[5]), jnp.sin(self.y[5])])

    def headings(self) -> Float[Array, " nodes"]:
        """Returns the angle [rad] of tau to the x axis at the nodes."""
        return self.y[5]

    def turning(self) -> Float[Array, " cells"]:
        """Returns the rate of turning [rad/s] about z in the cells."""
        return self.section().omega

    def bending(self) -> Float[Array, " cells"]:
        """Returns the curvature [1/m] about b in the cells."""
        return self.section().kappa

    def moments(self) -> Float[Array, " nodes"]:
        """Returns the bending moment M [N m] about b at the nodes."""
        return self.y[2]

    def head_force(self, angle: Array) -> tuple[Array, Array]:
        """Returns the force [N] on the head along axes that are turned by `angle` [rad] about z."""
        head = fields(self.y[:, -1])
        return to_plane(head.T, head.N, head.phi - angle)

    def yaw_moment(self) -> Array:
        """Returns the moment [N m] on the head about z."""
        return self.y[2, -1]

    def speed(self) -> Array:
        """Returns the speed [m/s] of the head along tau."""
        return self.y[3, -1]

    def force_density(self) -> Float[Array, "2 cells"]:
        """Returns the force per length (x, y) [N/m] of the effects in the cells."""
        section = self.section()
        (F_tau, F_n), *_ = forces_and_states(section, self.stage)
        return jnp.stack(to_plane(F_tau, F_n, section.phi))


def _blend(base: PyTree, last: PyTree, weight) -> PyTree:
    return jax.tree.map(lambda b, q: b + weight * (q - b), base, last)


def _reference(memory: Memory, mesh: Mesh, dt) -> Reference:
    V_tau, V_n, phi = mesh.grid.mid(memory.motion)
    kappa = mesh.grid.slope(memory.motion[2])
    lag = mesh.structure.damping_time / dt
    return Reference(V_tau, V_n, phi, kappa, memory.strain, memory.internal, dt, lag)


def _anchor(memory: Memory, support: Support, t) -> Float[Array, "2"]:
    return memory.head + support.anchor_offset(memory.motion[2, -1], t)


def make_step(model: Model, mesh: Mesh, numerics: Numerics, scheme: Scheme):
    """Returns the function that advances a `Carry` by one step.

    The returned function takes (carry, (t, h, chambers)): start `t` [s] and length `h` [s] of the
    step, and the stacked chambers at all stages. The function returns the new carry and a
    `Snapshot` at the step's end. Raises `ValueError` for a mesh in float32.
    """
    if mesh.grid.s.dtype != jnp.float64:
        raise ValueError(
            f"precision of the mesh: given {mesh.grid.s.dtype}; allowed float64; call "
            "slider_jax.enable_float64() before you create any array"
        )
    solver = BeamNewton(rtol=numerics.tolerance)
    scale = scales_of(model.body)
    predict = jnp.asarray(extrapolation(scheme))
    nodes, weights = jnp.asarray(scheme.nodes), jnp.asarray(scheme.weights)

    def stage_of(base, support, h, carry, stage_inputs):
        """Returns the guess of the solution, the stage, and the head's place for a solution."""
        t, weight, predictor, chambers, shape = stage_inputs
        reference = _blend(base, carry.memory, weight)
        dt = scheme.gamma * h
        at_reference = _reference(reference, mesh, dt)
        anchor = _blend(_anchor(base, support, t), _anchor(carry.memory, support, t), weight)

        def head_of(y):
            head = fields(y[:, -1])
            omega = (head.phi - reference.motion[2, -1]) / dt
            moved = anchor + dt * support.anchor_velocity(head, omega, t)
            return moved - support.anchor_offset(head.phi, t)

        def nodes_of_guess():
            """Predicts the positions (2, nodes) [m]; the error is of third order in the step.

            The compression by tendons, which moves the cells by micrometres, is neglected.
            """
            eps = strain(mesh.grid.mid(guess[0]), mesh.structure, at_reference)
            return node_positions(guess[5], eps, head_of(guess), mesh.grid)

        def place():
            return mesh.grid.mid(nodes_of_guess())

        guess = sum(w * y for w, y in zip(predictor, carry.history, strict=True))
        stage = Stage(
            structure=mesh.under(chambers.acting),
            effects=model.effects,
            support=support.in_stage(reference.support, dt),
            reference=at_reference,
            phi_head=reference.motion[2, -1],
            load_head=reference.load,
            pressure=chambers.acting @ mesh.windows,
            active_moment=chambers.acting @ mesh.chambers,
            water=model.water_at(place, t),
            t=t,
            actuators=model.actuators,
            shape=shape,
            immersion=model.immersion_at(nodes_of_guess),
        )
        return guess, stage, head_of

    def run_stage(base, support, h, factors, carry, stage_inputs):
        """Returns the new carry and the stage; `factors` belong to the first stage of the step."""
        t, *_, chambers, _ = stage_inputs
        guess, stage, head_of = stage_of(base, support, h, carry, stage_inputs)
        solution = solver.solve_stage(
            residual, jacobian, guess, stage, factors, scale, carry.ok, numerics.max_newton
        )
        converged = solution.result == optx.RESULTS.successful
        ok = carry.ok & converged
        y = jnp.where(ok, solution.value, carry.history[-1])
        section = at_cells(y, stage)
        solved = Memory(
            motion=y[3:],
            strain=section.strain,
            head=head_of(y),
            load=stage.load_head + stage.reference.dt * load_rates(y[:, -1], stage),
            internal=forces_and_states(section, stage)[2],
            support=stage.support.settled(*on_support(y[:, -1], stage), t),
        )
        memory = jax.tree.map(lambda a, b: jnp.where(ok, a, b), solved, carry.memory)
        new = Carry(
            history=jnp.concatenate([carry.history[1:], y[None]]),
            memory=memory,
            chambers=chambers,
            ok=ok,
            factorisations=carry.factorisations + solution.stats["num_steps"],
            failed_at=jnp.where(carry.ok & ~converged, t, carry.failed_at),
        )
        return new, stage

    def step(carry: Carry, inputs):
        t_start, h, chambers = inputs
        times = t_start + nodes * h
        support = model.support.during(t_start, t_start + h)
        shapes = shape_in_step(model.actuators, mesh.structure, scheme, t_start, h)
        rows = (times, weights, predict, chambers, shapes)
        first = jax.tree.map(lambda x: x[0], rows)
        if carry.memory.support is not None:
            at = carry.memory.head, carry.memory.motion[2, -1]
            state = support.begin(carry.memory.support, *at, t_start, t_start + h)
            carry = eqx.tree_at(lambda c: c.memory.support, carry, state)
        # All stages have the same gamma h, so one factorisation usually serves the whole step.
        count = carry.factorisations + jnp.where(carry.ok, 1, 0)
        carry = eqx.tree_at(lambda c: c.factorisations, carry, count)
        guess, stage, _ = stage_of(carry.memory, support, h, carry, first)
        factors = solver.factors(jacobian, guess, stage)
        one_stage = ft.partial(run_stage, carry.memory, support, h, factors)

        def body(state, stage_inputs):
            return one_stage(state[0], stage_inputs), None

        (carry, stage), _ = jax.lax.scan(body, (carry, stage), rows)
        y = carry.history[-1]
        return carry, Snapshot(times[-1], y, carry.memory, stage, mesh, carry.chambers)

    return step


def at_rest(model: Model, numerics: Numerics, t0: Scalar = 0.0) -> Carry:
    """Returns the carry of an unloaded body at rest relative to its support at `t0` [s].

    The body is straight, but it has the curvature and the motion that `PrescribedShape` actuators
    prescribe. Raises `InputError` for a model in three dimensions.
    """
    model.require_plane()
    velocity, angle, rate = model.support.start(jnp.asarray(t0))
    V_tau, V_n = to_body(velocity, angle)
    if has_shape(model.actuators):
        mesh = make_mesh(model.body, numerics)
        shape, kappa = shape_at(model.actuators, mesh.structure, jnp.asarray(t0, float))
        y, memory = curved_state(mesh.grid, V_tau, V_n, angle, rate, kappa, shape.rate)
    else:
        s = grid_of(model.body, numerics).s
        y, memory = straight_state(s, V_tau, V_n, angle, rate)
    memory = eqx.tree_at(
        lambda m: (m.internal, m.support),
        memory,
        (states_at_rest(model.effects, memory.strain), model.support.start_state()),
        is_leaf=lambda x: x is None,
    )
    return initial_carry(y, memory, start_chambers(model))


def with_motion(carry: Carry, change: Callable[[Array], Array]) -> Carry:
    """Returns the carry with `change(rows)` for its rows (V_tau, V_n, phi), (..., 3, nodes)."""
    history = carry.history.at[:, 3:].set(change(carry.history[:, 3:]))
    rows = change(carry.memory.motion), history
    return eqx.tree_at(lambda c: (c.memory.motion, c.history), carry, rows)


def initial_carry(y: Unknowns, memory: Memory, chambers: Chambers) -> Carry:
    """Returns the carry of a rollout that starts at the state (y, memory, chambers)."""
    return Carry(
        history=jnp.broadcast_to(y, (KNOWN, *y.shape)),
        memory=memory,
        chambers=chambers,
        ok=jnp.asarray(True),
        factorisations=jnp.asarray(0),
        failed_at=jnp.asarray(jnp.inf, y.dtype),
    )
