"""Small models and solvers that the physics tests share."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from slider_jax.actuation import FirstOrderLag, SineWave, SquareWave
from slider_jax.beam.equations import Reference
from slider_jax.beam.parameters import Numerics, grid_of, uniform_robot
from slider_jax.beam.state import node_positions
from slider_jax.channels import SLIDER_CHANNELS
from slider_jax.dynamics.model import Drive, Model, make_mesh
from slider_jax.dynamics.residual import Stage, residual
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.dynamics.statics import at_rest_under
from slider_jax.dynamics.step import at_rest
from slider_jax.dynamics.time_schemes import SDIRK2
from slider_jax.effects import NormalDrag, ReactiveForce, Readings
from slider_jax.supports import Clamped

SMALL = Numerics(tail_cells=4, body_cells=12)
"""A coarse mesh with body and tail."""


def swimmer(
    frequency=4.8,
    amplitude=250e3,
    phase=0.15,
    C_d=3.0,
    m_a=1.0,
    k=0.087,
    wave=SquareWave,
    support=None,
    effects=None,
    **robot,
) -> Model:
    """Returns the built-in robot in water, clamped, with both chambers driven, as arrays."""
    model = Model(
        uniform_robot(**robot),
        (NormalDrag(C_d), ReactiveForce(m_a)) if effects is None else effects,
        FirstOrderLag(k),
        Drive((wave(frequency, amplitude), wave(frequency, amplitude, phase))),
        Clamped() if support is None else support,
    )
    return arrays(model)


def arrays(tree):
    """Returns the tree with float64 arrays, so that all values share one compiled program."""
    return jax.tree.map(lambda x: jnp.asarray(x, float), tree)


_static_state = eqx.filter_jit(at_rest_under)


def static_state(model, loads, numerics=Numerics(), t=0.0):
    """Returns `at_rest_under`, compiled once for all models of the same structure."""
    return _static_state(arrays(model), arrays(loads), numerics, jnp.asarray(t, float))


def uniform(L=0.368, EI=0.038, effects=(), support=None, **robot) -> Model:
    """Returns a passive uniform rod without drive, by default without damping."""
    shape = {"body_length": 0.8 * L, "tail_length": 0.2 * L, "EI_body": EI, "EI_tail": EI}
    rod = {"damping_time": 0.0, "EA_body": 1e6, "EA_tail": 1e6, "K_Q": 0.0} | shape | robot
    return arrays(
        Model(
            uniform_robot(**rod),
            tuple(effects),
            FirstOrderLag(0.1),
            Drive((SineWave(1.0, 0.0), SineWave(1.0, 0.0))),
            Clamped() if support is None else support,
        )
    )


def nodes_of(model: Model, numerics: Numerics):
    """Returns the nodes' distances from the tail [m]."""
    return grid_of(model.body, numerics).s


def stage_of(model: Model, numerics: Numerics, y_reference, dt, t=0.0, active_moment=None) -> Stage:
    """Returns a stage with time derivatives (q(y) - q(y_reference))/dt; a long dt gives statics."""
    mesh = make_mesh(model.robot, numerics)
    T, _, _, V_tau, V_n, phi = mesh.grid.mid(y_reference)
    reference = Reference(
        V_tau=V_tau,
        V_n=V_n,
        phi=phi,
        kappa=mesh.grid.slope(y_reference[5]),
        strain=T / mesh.structure.EA,
        internal=(),
        dt=jnp.asarray(dt, float),
        lag=mesh.structure.damping_time / dt,
    )
    return Stage(
        structure=mesh.structure,
        effects=model.effects,
        support=model.support,
        reference=reference,
        phi_head=y_reference[5, -1],
        load_head=y_reference[:3, -1],
        pressure=0.0 * mesh.grid.ds,
        active_moment=0.0 * mesh.grid.ds if active_moment is None else active_moment,
        water=model.uniform_water_at(jnp.asarray(t, float)),
        t=jnp.asarray(t, float),
    )


def flat_residual(y, stage, tail_load=None):
    """Returns the residual as one vector; `tail_load(phi)` gives (T, N, M) at the tail's end."""
    cells, tail, head = residual(y, stage)
    if tail_load is not None:
        tail = tail - tail_load(y[5, 0])
    return jnp.concatenate([cells.ravel(), tail, head])


@eqx.filter_jit
def dense_newton(stage, y, tail_load=None, iterations=40):
    """Solves by Newton's method with a dense Jacobian, as a reference; returns y, |residual|."""

    def value(v):
        return flat_residual(v.reshape(y.shape), stage, tail_load)

    def body(_, v):
        return v - jnp.linalg.solve(jax.jacfwd(value)(v), value(v))

    v = jax.lax.fori_loop(0, iterations, body, y.ravel())
    return v.reshape(y.shape), jnp.max(jnp.abs(value(v)))


def order(sizes, errors) -> float:
    """Returns the slope of log(error) over log(size) by least squares."""
    return float(np.polyfit(np.log(np.asarray(sizes)), np.log(np.asarray(errors)), 1)[0])


def observe(x):
    """Returns thrust [N], recoil [N] and tip [m] of a clamped robot."""
    shape = node_positions(x.y[5], x.memory.strain, x.head, x.mesh.grid)
    return jnp.stack([-x.y[0, -1], -x.y[1, -1], shape[1, 0] - x.head[1]])


@eqx.filter_jit
def _chunk(model, h, t0, begin, steps, save, numerics, scheme):
    return rollout(model, TimeGrid(h, steps, t0), save, numerics, scheme, begin=begin)


def march(model, h, steps, save=observe, numerics=SMALL, scheme=SDIRK2, chunk=40):
    """Runs a rollout in chunks of one compiled program, for any step size and number of steps.

    Returns the times and the saved values as numpy arrays; a failed step fails the test.
    """
    assert steps % chunk == 0
    carry = at_rest(model, numerics)
    times, kept = [], []
    for i in range(steps // chunk):
        t0 = jnp.asarray(i * chunk * h)
        out = _chunk(model, jnp.asarray(h), t0, carry, chunk, save, numerics, scheme)
        carry = out.final
        times.append(out.t)
        kept.append(out.saved)
    assert bool(carry.ok), f"step failed at {float(carry.failed_at)} s"
    return np.concatenate(times), jax.tree.map(lambda *x: np.concatenate(x), *kept)


def slider_readings(t, *series):
    """Readings of SLIDER: `series` are front and rear pressure, thrust, recoil and tip (n,)."""
    return Readings(t, jnp.stack(series[:2]), *series[2:])


def reading(x, name):
    """The series of a channel of SLIDER, or the times "t", in the readings `x`."""
    pressures = dict(zip(SLIDER_CHANNELS.pressures, x.pressures, strict=True))
    return pressures[name] if name in pressures else getattr(x, name)
