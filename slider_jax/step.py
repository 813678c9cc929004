"""One time step: its stages, each a root find."""

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float

from slider_jax.beam import Reference, Section, section, strain
from slider_jax.frame import to_body
from slider_jax.model import Mesh, Model
from slider_jax.newton import BeamAdjoint, BeamNewton
from slider_jax.parameters import Numerics, scales_of
from slider_jax.residual import Stage, jacobian, mid_and_slope, residual
from slider_jax.scheme import Scheme, extrapolation
from slider_jax.state import Memory, Unknowns, fields, straight


class Carry(eqx.Module):
    """What one step hands to the next."""

    history: Float[Array, "3 6 nodes"]
    """The last three solutions, oldest first: they predict the next."""
    memory: Memory
    pressure: Float[Array, "2"]
    """Of the two chambers [Pa]."""
    ok: Bool[Array, ""]
    """False from the first stage that did not converge; the state is frozen from there on."""
    newton: Array
    """Newton iterations spent so far."""
    failed_at: Array
    """Time [s] of the stage that failed, or inf."""


class Snapshot(eqx.Module):
    """The system at the end of a step, as observables see it."""

    t: Array
    y: Unknowns
    memory: Memory
    stage: Stage
    mesh: Mesh
    pressure: Float[Array, "2"]

    @property
    def head(self) -> Float[Array, "2"]:
        """Position of the head [m]."""
        return self.stage.support.head_position(self.memory.anchor, self.y[5, -1], self.t)

    def section(self) -> Section:
        """The kinematics in the cells."""
        mid, slope = mid_and_slope(self.y, self.mesh.structure.ds)
        stage = self.stage
        return section(mid, slope, stage.structure, stage.reference, stage.water, stage.t)


def _blend(base: Memory, last: Memory, weight) -> Memory:
    return jax.tree.map(lambda b, q: b + weight * (q - b), base, last)


def _reference(memory: Memory, mesh: Mesh, dt) -> Reference:
    V_tau, V_n, phi = mesh.grid.mid(memory.motion)
    kappa = mesh.grid.slope(memory.motion[2])
    return Reference(V_tau, V_n, phi, kappa, memory.strain, dt)


def make_step(model: Model, mesh: Mesh, numerics: Numerics, scheme: Scheme):
    """The function that advances a `Carry` by one step.

    It takes (carry, (t, h, pressures)): the step's start and length [s], and the chambers'
    pressures [Pa] at each stage, (stages, 2). It returns the new carry and a `Snapshot` at the
    step's end.
    """
    solver = BeamNewton(rtol=numerics.tolerance)
    scale = scales_of(model.robot).per_unknown
    water = jnp.stack([jnp.asarray(u, mesh.grid.s.dtype) for u in model.water])
    predict = jnp.asarray(extrapolation(scheme))
    nodes, weights = jnp.asarray(scheme.nodes), jnp.asarray(scheme.weights)

    def run_stage(base, h, carry, stage_inputs):
        t, weight, predictor, pressure = stage_inputs
        reference = _blend(base, carry.memory, weight)
        dt = scheme.gamma * h
        stage = Stage(
            structure=mesh.structure,
            effects=model.effects,
            support=model.support,
            reference=_reference(reference, mesh, dt),
            phi_head_reference=reference.motion[2, -1],
            active_moment=pressure @ mesh.chambers,
            water=water,
            t=t,
        )
        guess = jnp.tensordot(predictor, carry.history, 1)
        solution = optx.root_find(
            residual,
            solver,
            guess,
            args=stage,
            options={"jacobian": jacobian, "scale": scale},
            max_steps=numerics.max_newton,
            adjoint=BeamAdjoint(),
            throw=False,
        )
        converged = solution.result == optx.RESULTS.successful
        ok = carry.ok & converged
        y = jnp.where(ok, solution.value, carry.history[-1])
        head = fields(y[:, -1])
        omega = (head.phi - stage.phi_head_reference) / dt
        drift = model.support.anchor_velocity(head, omega, t)
        T_mid = mesh.grid.mid(y[0])
        found = Memory(
            motion=y[3:],
            strain=strain(T_mid, mesh.structure, stage.reference),
            anchor=reference.anchor + dt * drift,
        )
        memory = jax.tree.map(lambda a, b: jnp.where(ok, a, b), found, carry.memory)
        new = Carry(
            history=jnp.concatenate([carry.history[1:], y[None]]),
            memory=memory,
            pressure=pressure,
            ok=ok,
            newton=carry.newton + solution.stats["num_steps"],
            failed_at=jnp.where(carry.ok & ~converged, t, carry.failed_at),
        )
        return new, stage

    def step(carry: Carry, inputs):
        t_start, h, pressures = inputs
        # The support may change between steps (a pin that switches sides), so re-anchor first.
        t_inside = t_start + scheme.nodes[0] * h
        base = eqx.tree_at(
            lambda m: m.anchor,
            carry.memory,
            model.support.reanchor(
                carry.memory.anchor, carry.memory.motion[2, -1], t_start, t_inside
            ),
        )
        carry = eqx.tree_at(lambda c: c.memory, carry, base)

        times = t_start + nodes * h

        def body(state, stage_inputs):
            inner, _ = state
            return run_stage(base, h, inner, stage_inputs), None

        rows = (times, weights, predict, pressures)
        empty = jax.eval_shape(run_stage, base, h, carry, jax.tree.map(lambda x: x[0], rows))[1]
        placeholder = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), empty)
        (carry, stage), _ = jax.lax.scan(body, (carry, placeholder), rows)
        snapshot = Snapshot(times[-1], carry.history[-1], carry.memory, stage, mesh, pressures[-1])
        return carry, snapshot

    return step


def at_rest(model: Model, numerics: Numerics) -> Carry:
    """The carry of a straight, unloaded body at rest in its support at t = 0."""
    velocity, angle = model.support.initial()
    drive = model.drive
    pressure = jnp.stack([jnp.asarray(p, float) for p in (drive.start_front, drive.start_rear)])
    V_tau, V_n = to_body(velocity, angle)
    return start(*straight(numerics.nodes, V_tau, V_n, angle), pressure)


def start(y: Unknowns, memory: Memory, pressure: Float[Array, "2"]) -> Carry:
    """The carry that begins a rollout at the state (y, memory), the chambers at `pressure` [Pa]."""
    return Carry(
        history=jnp.broadcast_to(y, (3, *y.shape)),
        memory=memory,
        pressure=pressure,
        ok=jnp.asarray(True),
        newton=jnp.asarray(0),
        failed_at=jnp.asarray(jnp.inf, y.dtype),
    )
