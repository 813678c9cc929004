"""Time steps and series of time steps of a robot in three dimensions."""

import functools as ft
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float

from slider_jax.actuation import Tendon
from slider_jax.beam.parameters import Numerics, grid_of, scales_of
from slider_jax.beam.spatial import (
    Quaternion,
    SpatialReference,
    SpatialSection,
    Vec,
    about_b,
    about_tau,
    rotation_vector,
    turned,
    unit,
)
from slider_jax.dynamics.model import Model, SpaceSettings
from slider_jax.dynamics.newton import BeamNewton
from slider_jax.dynamics.pressures import Chambers, start_chambers
from slider_jax.dynamics.rollout import TimeGrid, run_steps
from slider_jax.dynamics.time_schemes import KNOWN, SDIRK2, Scheme, extrapolation, parabolas
from slider_jax.effects import in_space, total_load
from slider_jax.spatial.lines import chamber_lines, lines_of_chambers, tendon_lines
from slider_jax.spatial.mesh import SpatialMesh, spatial_mesh
from slider_jax.spatial.residual import (
    LEFT,
    RIGHT,
    SpatialStage,
    at,
    frame_and_omega,
    moment_of_chambers,
    sections,
    spatial_jacobian,
    spatial_residual,
    tensions_in_space,
    turning_in_cells,
    vectors,
)
from slider_jax.water import WaterField


class SpatialMemory(eqx.Module):
    """Values that one stage passes to the next one, to compute time derivatives.

    `V` [m/s], `omega` [rad/s] and `theta` [rad] (3, nodes), `strain` (cells,) [-] and position
    `head` (3,) [m]. theta is relative to the start of the step.
    """

    V: Float[Array, "3 nodes"]
    omega: Float[Array, "3 nodes"]
    theta: Float[Array, "3 nodes"]
    strain: Float[Array, " cells"]
    head: Float[Array, "3"]


class SpatialCarry(eqx.Module):
    """The state that one step passes to the next step."""

    history: Float[Array, "4 9 nodes"]
    """T, M and V of the last solutions, oldest first, which predict the next solution."""
    frames: Float[Array, "4 4 nodes"]
    """Quaternions of the frames of these solutions."""
    twist: Float[Array, "3 cells"]
    """Twist [1/m] of the last three solutions."""
    memory: SpatialMemory
    chambers: Chambers
    ok: Bool[Array, ""]
    """False after a stage did not converge; from this stage on, the state remains frozen."""
    factorisations: Array
    """Number of factorisations of the Jacobian so far."""
    failed_at: Array
    """Time [s] of the failed stage; inf if no stage failed."""


class SpatialSnapshot(eqx.Module):
    """The robot at the end of a step, from which observables are computed."""

    t: Array
    y: Float[Array, "12 nodes"]
    frame: Float[Array, "4 nodes"]
    """Quaternions of the frames."""
    memory: SpatialMemory
    stage: SpatialStage
    mesh: SpatialMesh
    chambers: Chambers

    def section(self) -> SpatialSection:
        """Returns the local state of the body in each cell."""
        return sections(self.y, self.stage)

    def positions(self) -> Float[Array, "3 nodes"]:
        """Returns the positions (x, y, z) [m] of the nodes, integrated backwards from the head."""
        q = Quaternion(*self.frame)
        left, right = at(q, LEFT), at(q, RIGHT)
        half = turned(rotation_vector(left.inverse().after(right)).times(0.5))
        length = (1.0 + self.memory.strain) * self.mesh.grid.ds
        zero = jnp.zeros_like(length)
        steps = left.after(half).to_space(Vec(length, zero, zero))
        behind = jnp.cumsum(steps[:, ::-1], axis=1)[:, ::-1]
        none = jnp.zeros((3, 1), behind.dtype)
        return self.memory.head[:, None] - jnp.concatenate([behind, none], axis=1)

    @property
    def head(self) -> Float[Array, "3"]:
        """Position (x, y, z) [m] of the head."""
        return self.memory.head

    def directions(self) -> Float[Array, "3 nodes"]:
        """Returns the unit vectors tau (x, y, z) at the nodes."""
        one = jnp.ones_like(self.frame[0])
        return Quaternion(*self.frame).to_space(Vec(one, 0.0 * one, 0.0 * one))

    def headings(self) -> Float[Array, " nodes"]:
        """Returns the angle [rad] of tau, seen from above, to the x axis at the nodes."""
        x, y, _ = self.directions()
        return jnp.unwrap(jnp.arctan2(y, x)[::-1])[::-1]

    def turning(self) -> Float[Array, " cells"]:
        """Returns the rate of turning [rad/s] about z in the cells."""
        x = self.section()
        return x.frame.to_space(x.omega)[2]

    def bending(self) -> Float[Array, " cells"]:
        """Returns the curvature [1/m] about b in the cells."""
        return self.section().curvature.b

    def moments(self) -> Float[Array, " nodes"]:
        """Returns the bending moment [N m] about b at the nodes."""
        return self.y[5]

    def head_force(self, angle: Array) -> tuple[Array, Array]:
        """Returns the force [N] on the head along axes that are turned by `angle` [rad] about z."""
        x, y, _ = at(Quaternion(*self.frame), -1).to_space(Vec(*self.y[:3, -1]))
        c, s = jnp.cos(angle), jnp.sin(angle)
        return c * x + s * y, c * y - s * x

    def yaw_moment(self) -> Array:
        """Returns the moment [N m] on the head about z."""
        return at(Quaternion(*self.frame), -1).to_space(Vec(*self.y[3:6, -1]))[2]

    def speed(self) -> Array:
        """Returns the speed [m/s] of the head along tau."""
        return self.y[6, -1]

    def actuator_power(self) -> Array:
        """Returns the mechanical power [W] of chambers and tendons on the body.

        It is the integral of M_act dOmega/dt - P_c d(eps)/dt, with the active moment M_act and the
        compression P_c by tendons.
        """
        x, stage = self.section(), self.stage
        active, compression = moment_of_chambers(x, stage), jnp.zeros_like(x.strain)
        tension = tensions_in_space(self.mesh.grid.mid(self.y[0]), x.curvature, stage)
        if stage.tendons is not None and tension is not None:
            compression, pulled = stage.tendons.loads(tension, x.strain, x.curvature)
            active = active.plus(pulled)
        strain_t = (x.strain - stage.reference.strain) / stage.reference.dt
        bending = sum(m * rate for m, rate in zip(active, x.curvature_t, strict=True))
        return self.mesh.grid.integral(bending - compression * strain_t)

    def force_density(self) -> Float[Array, "3 cells"]:
        """Returns the force per length (x, y, z) [N/m] of the effects in the cells."""
        x = self.section()
        return x.frame.to_space(total_load(self.stage.effects, x).force)


class SpatialRollout(eqx.Module):
    """Result of a rollout: times [s], quantities saved at each step, final carry, and mesh."""

    t: Float[Array, " steps"]
    saved: Any
    final: SpatialCarry
    mesh: SpatialMesh

    @property
    def ok(self):
        """Whether every step converged."""
        return self.final.ok


def settings_in_space(model: Model) -> SpaceSettings:
    """Returns `model.space`. Raises `ValueError` if the model contains something planar only."""
    wrong = [effect.name() for effect in model.effects if not in_space(effect)]
    if wrong:
        raise ValueError(
            f"a robot in three dimensions: given the effects {', '.join(wrong)}, which are defined "
            "in the plane only; remove them or use two dimensions"
        )
    if not all(isinstance(x, Tendon) for x in model.actuators):
        kinds = ", ".join({type(x).__name__ for x in model.actuators if not isinstance(x, Tendon)})
        raise ValueError(
            f"a robot in three dimensions: given the actuators {kinds}; allowed chambers and "
            "tendons; remove the others or use two dimensions"
        )
    if isinstance(model.water, WaterField):
        raise ValueError(
            "a robot in three dimensions: given a velocity field of the water; allowed still or "
            "uniform water, or two dimensions"
        )
    if model.space is None:
        raise ValueError("a robot in three dimensions: Model.space is None; set SpaceSettings")
    if model.robot.stiffening is not None:
        raise ValueError(
            "a robot in three dimensions: given stiffening by pressure; remove it or use two "
            "dimensions"
        )
    if model.space.far_angles is not None and model.space.distances is None:
        raise ValueError(
            "a robot in three dimensions: far_angles of helical chambers without distances; set "
            "SpaceSettings.distances"
        )
    return model.space


def _scales(model: Model) -> Float[Array, "12 1"]:
    force, _, moment, speed, _, angle = scales_of(model.body)
    return jnp.stack([*[force] * 3, *[moment] * 3, *[speed] * 3, *[angle] * 3])


def _space(x) -> Float[Array, "..."]:
    """Returns the vector in space of (x, y) components in the horizontal plane."""
    return jnp.concatenate([x, jnp.zeros_like(x[..., :1])], axis=-1)


def make_spatial_step(model: Model, mesh: SpatialMesh, numerics: Numerics, scheme: Scheme):
    """Returns the function that advances a `SpatialCarry` by one step; see `make_step`."""
    solver = BeamNewton(rtol=numerics.tolerance)
    scale = _scales(model)
    predict, parabola = jnp.asarray(extrapolation(scheme)), jnp.asarray(parabolas(scheme))
    nodes, weights = jnp.asarray(scheme.nodes), jnp.asarray(scheme.weights)
    grid, space = mesh.grid, settings_in_space(model)
    angles, zero = jnp.asarray(space.angles, float), jnp.zeros_like(grid.ds)
    tendons = tendon_lines(model.actuators, mesh.structure)
    places = lines_of_chambers(space, model.body.chambers, mesh.structure)
    bending_n = -mesh.chambers * jnp.sin(angles)[:, None]
    bending_b = mesh.chambers * jnp.cos(angles)[:, None]

    def mean_of(x: Float[Array, "3 nodes"]) -> Vec:
        return Vec(*grid.mid(x))

    def stage_of(base: SpatialMemory, start: Quaternion, support, h, carry, stage_inputs):
        """Returns guess of the solution, stage, last solution, and the anchor's reference place."""
        t, weight, predictor, of_twist, chambers = stage_inputs
        memory = jax.tree.map(lambda b, q: b + weight * (q - b), base, carry.memory)
        dt = scheme.gamma * h
        slope = jnp.asarray(jnp.gradient(of_twist @ carry.twist, grid.mid(grid.s)))
        reference = SpatialReference(
            V=mean_of(memory.V),
            omega=mean_of(memory.omega),
            strain=memory.strain,
            twist_slope=slope,
            dt=dt,
        )
        water = model.uniform_water_at(t)
        pressure = chambers.acting
        active = Vec(zero, pressure @ bending_n, pressure @ bending_b)
        stage = SpatialStage(
            structure=mesh.structure,
            effects=model.effects,
            support=support,
            reference=reference,
            frame=start,
            theta=Vec(*memory.theta),
            active_moment=active if places is None else Vec(zero, zero, zero),
            water=None if water is None else _space(water),
            t=t,
            tendons=tendons,
            chambers=chamber_lines(places, pressure, mesh.chambers),
        )

        def theta_of(frames):
            return jnp.stack(rotation_vector(start.inverse().after(Quaternion(*frames))))

        known = jnp.concatenate([carry.history, jax.vmap(theta_of)(carry.frames)], axis=1)
        guess = sum(w * y for w, y in zip(predictor, known, strict=True))
        return guess, stage, known[-1], memory.head

    def run_stage(base, start, support, h, factors, carry, stage_inputs):
        """Returns the new carry, and the stage with its solution.

        `factors` belong to the first stage of the step.
        """
        t, *_, chambers = stage_inputs
        guess, stage, last, anchor = stage_of(base, start, support, h, carry, stage_inputs)
        dt = stage.reference.dt
        solution = solver.solve_stage(
            spatial_residual, spatial_jacobian, guess, stage, factors, scale, carry.ok,
            numerics.max_newton,
        )  # fmt: skip
        converged = solution.result == optx.RESULTS.successful
        ok = carry.ok & converged
        y = jnp.where(ok, solution.value, last)
        _, _, V, theta = vectors(y)
        frame, omega = frame_and_omega(theta, stage)
        frame = unit(frame)
        turning = turning_in_cells(theta, stage)
        arm = support.anchor_in_space(t)
        head_frame, head_omega = at(frame, -1), at(omega, -1)
        anchor_speed = head_frame.to_space(at(V, -1).plus(head_omega.cross(arm)))
        anchor = anchor + dt * anchor_speed
        solved = SpatialMemory(
            V=jnp.stack(V),
            omega=jnp.stack(omega),
            theta=jnp.stack(theta),
            strain=sections(y, stage).strain,
            head=anchor,
        )
        state = jax.tree.map(lambda a, b: jnp.where(ok, a, b), solved, carry.memory)
        quaternions = jnp.where(ok, jnp.stack(frame), carry.frames[-1])

        def appended(series, last):
            return jnp.concatenate([series[1:], last[None]])

        new = SpatialCarry(
            history=appended(carry.history, y[:9]),
            frames=appended(carry.frames, quaternions),
            twist=appended(carry.twist, jnp.where(ok, turning.curvature.tau, carry.twist[-1])),
            memory=state,
            chambers=chambers,
            ok=ok,
            factorisations=carry.factorisations + solution.stats["num_steps"],
            failed_at=jnp.where(carry.ok & ~converged, t, carry.failed_at),
        )
        return new, (stage, y)

    def step(carry: SpatialCarry, inputs):
        t_start, h, chambers = inputs
        support = model.support.during(t_start, t_start + h)
        start = Quaternion(*carry.frames[-1])
        # The integrated point is the reference point of the support, not the head.
        offset = at(start, -1).to_space(support.anchor_in_space(t_start))
        base = eqx.tree_at(
            lambda m: (m.theta, m.head),
            carry.memory,
            (jnp.zeros_like(carry.memory.theta), carry.memory.head + offset),
        )
        carry = eqx.tree_at(lambda c: c.memory, carry, base)

        rows = (t_start + nodes * h, weights, predict, parabola, chambers)
        first = jax.tree.map(lambda x: x[0], rows)
        # All stages have the same gamma h, so one factorisation usually serves the whole step.
        count = carry.factorisations + jnp.where(carry.ok, 1, 0)
        carry = eqx.tree_at(lambda c: c.factorisations, carry, count)
        guess, stage, y, _ = stage_of(base, start, support, h, carry, first)
        factors = solver.factors(spatial_jacobian, guess, stage)
        one_stage = ft.partial(run_stage, base, start, support, h, factors)

        def body(state, stage_inputs):
            return one_stage(state[0], stage_inputs), None

        (carry, (stage, y)), _ = jax.lax.scan(body, (carry, (stage, y)), rows)
        last = Quaternion(*carry.frames[-1])
        end = at(last, -1).to_space(support.anchor_in_space(t_start + h))
        carry = eqx.tree_at(lambda c: c.memory.head, carry, carry.memory.head - end)
        snapshot = SpatialSnapshot(
            t_start + h, y, carry.frames[-1], carry.memory, stage, mesh, carry.chambers
        )
        return carry, snapshot

    return step


def at_rest_in_space(
    model: Model, numerics: Numerics, t0=0.0, attitude: Quaternion | None = None
) -> SpatialCarry:
    """Returns the carry of an unloaded straight body at rest relative to its support at `t0` [s].

    `attitude` is the frame of the body before the support turns it about z; by default, tau is
    along x, and the body is rolled by `space.roll`.
    """
    roll = settings_in_space(model).roll
    t = jnp.asarray(t0, float)
    velocity, angle, rate = model.support.start(t)
    one = jnp.ones_like(t)
    own = about_tau(jnp.asarray(roll, float)) if attitude is None else attitude
    frame = about_b(jnp.asarray(angle, float)).after(own)
    s = grid_of(model.body, numerics).s
    zero = jnp.zeros_like(s)
    turning = frame.to_frame(jnp.stack([0.0 * one, 0.0 * one, rate * one]))
    ahead = frame.to_frame(_space(jnp.stack([jnp.asarray(v, float) for v in velocity])))
    behind = turning.cross(Vec(s - s[-1], zero, zero))
    V = jnp.stack(ahead.plus(behind)) + 0.0 * s
    omega = jnp.stack(turning)[:, None] + 0.0 * s
    memory = SpatialMemory(
        V=V, omega=omega, theta=jnp.zeros_like(V), strain=zero[1:], head=jnp.zeros(3)
    )
    y = jnp.concatenate([jnp.zeros((6, len(s))), V])
    frames = jnp.stack(frame)[:, None] + 0.0 * s
    return SpatialCarry(
        history=jnp.broadcast_to(y, (KNOWN, *y.shape)),
        frames=jnp.broadcast_to(frames, (KNOWN, *frames.shape)),
        twist=jnp.zeros((3, len(s) - 1)),
        memory=memory,
        chambers=start_chambers(model),
        ok=jnp.asarray(True),
        factorisations=jnp.asarray(0),
        failed_at=jnp.asarray(np.inf),
    )


def straight_line(carry: SpatialCarry, s: Float[Array, " nodes"]) -> Float[Array, "3 nodes"]:
    """Returns the positions [m] of the nodes `s` [m] of a straight body, relative to the head."""
    zero = jnp.zeros_like(s)
    return Quaternion(*carry.frames[-1]).to_space(Vec(s - s[-1], zero, zero))


def spatial_rollout(
    model: Model,
    times: TimeGrid,
    save: Callable[[SpatialSnapshot], Any],
    numerics: Numerics = Numerics(),
    scheme: Scheme = SDIRK2,
    *,
    begin: SpatialCarry | None = None,
    checkpoint: bool = True,
) -> SpatialRollout:
    """Integrates `model` in three dimensions; see `dynamics.rollout.rollout`.

    The water is uniform. Raises `ValueError` for a model without `space`, or for a model that
    contains something of the plane only.
    """
    settings_in_space(model)
    mesh = spatial_mesh(model.body, numerics)
    if begin is None:
        begin = at_rest_in_space(model, numerics, times.t0)
    step = make_spatial_step(model, mesh, numerics, scheme)
    final, saved = run_steps(step, begin, model, times, save, scheme, None, checkpoint)
    return SpatialRollout(times.times, saved, final, mesh)
