"""Simulates one robot for many time steps; JAX can differentiate and batch the simulation."""

import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.parameters import Numerics, Scalar
from slider_jax.dynamics.model import Mesh, Model, make_mesh
from slider_jax.dynamics.newton import SOLUTION
from slider_jax.dynamics.pressures import Chambers, chamber_history
from slider_jax.dynamics.step import Carry, Snapshot, at_rest, make_step
from slider_jax.dynamics.time_schemes import SDIRK2, Scheme


class TimeGrid(eqx.Module):
    """`steps` equal steps of `h` [s] that start at `t0` [s]."""

    h: Scalar
    steps: int = eqx.field(static=True)
    t0: Scalar = 0.0

    @classmethod
    def per_stride(cls, frequency: Scalar, steps_per_stride: int, strides: int) -> "TimeGrid":
        """Returns a grid of `strides` strides at the `frequency` [Hz].

        If `steps_per_stride` is even, edges of a square wave without delay are at ends of steps.
        """
        return cls(1.0 / (frequency * steps_per_stride), steps_per_stride * strides)

    @property
    def times(self) -> Float[Array, " steps"]:
        """Time [s] at the end of every step."""
        return self.t0 + self.h * jnp.arange(1.0, self.steps + 1.0)


class Rollout(eqx.Module):
    """Result of a rollout: times [s], quantities saved at each step, final carry, and mesh."""

    t: Float[Array, " steps"]
    saved: Any
    final: Carry
    mesh: Mesh

    @property
    def ok(self):
        """Whether every step converged."""
        return self.final.ok


def rollout(
    model: Model,
    times: TimeGrid,
    save: Callable[[Snapshot], Any],
    numerics: Numerics = Numerics(),
    scheme: Scheme = SDIRK2,
    *,
    begin: Carry | None = None,
    chambers: Chambers | None = None,
    checkpoint: bool = True,
) -> Rollout:
    """Integrates `model` over `times` and stores `save(snapshot)` at the end of every step.

    Without `begin`, the body starts straight and at rest relative to its support. To continue an
    earlier rollout, pass its `final` as `begin`. `chambers` is the `chamber_history` at the ends of
    all stages (default: computed from the drive). If a step fails, the state remains frozen and
    `ok` is false. Raises `InputError` for a model in three dimensions; see `spatial_rollout`. No
    error is raised for a failed step, because an error would stop all robots of a batch.
    Callers such as `simulate_trial` raise `SolverError`. With `checkpoint`, reverse-mode
    differentiation stores only the carry of each block of steps and computes the steps a second
    time. Choose a number of steps that has a divisor near its square root (`block_size`).
    """
    model.require_plane()
    mesh = make_mesh(model.body, numerics)
    if begin is None:
        begin = at_rest(model, numerics, times.t0)
    step = make_step(model, mesh, numerics, scheme)
    final, saved = run_steps(step, begin, model, times, save, scheme, chambers, checkpoint)
    return Rollout(times.times, saved, final, mesh)


def run_steps(
    step: Callable,
    begin: Any,
    model: Model,
    times: TimeGrid,
    save: Callable[[Any], Any],
    scheme: Scheme,
    chambers: Chambers | None,
    checkpoint: bool,
) -> tuple[Any, Any]:
    """Returns the final carry and the saved series of `step`, repeated over `times`.

    `step` and its carry `begin` are planar or in three dimensions. For the other arguments, see
    `rollout`.
    """
    begins = times.t0 + times.h * jnp.arange(float(times.steps))
    if chambers is None:
        at = begins[:, None] + times.h * jnp.asarray(scheme.nodes)  # (steps, stages)
        at = jnp.concatenate([jnp.asarray(times.t0, at.dtype)[None], at.ravel()])
        chambers = chamber_history(model, begin.chambers, at)
    shape = (times.steps, scheme.stages)
    stages = jax.tree.map(lambda x: x.reshape(*shape, *x.shape[1:]), chambers)

    def body(carry, inputs):
        t, chambers = inputs
        carry, snapshot = step(carry, (t, jnp.asarray(times.h), chambers))
        return carry, save(snapshot)

    inputs = begins, stages
    if not checkpoint:
        return jax.lax.scan(body, begin, inputs)
    body = jax.checkpoint(
        body, prevent_cse=False, policy=jax.checkpoint_policies.save_only_these_names(SOLUTION)
    )
    block = jax.checkpoint(lambda carry, x: jax.lax.scan(body, carry, x), prevent_cse=False)
    size = block_size(times.steps)
    final, saved = jax.lax.scan(
        block, begin, jax.tree.map(lambda x: x.reshape(-1, size, *x.shape[1:]), inputs)
    )
    return final, jax.tree.map(lambda x: x.reshape(times.steps, *x.shape[2:]), saved)


def block_size(steps: int) -> int:
    """Returns the largest divisor of `steps` up to its square root: the steps of a block.

    Reverse mode stores the carry of each block and, for one block at a time, the values of each
    step. The memory is therefore proportional to the square root of `steps` if a divisor is close
    to it. A prime number of steps has blocks of one step.
    """
    return next(k for k in range(max(math.isqrt(steps), 1), 0, -1) if steps % k == 0)


def continued(
    carry: Carry, model: Model, times: TimeGrid, save, numerics: Numerics, scheme: Scheme
) -> Rollout:
    """Returns the `rollout` that begins at `carry`, without checkpoints for reverse mode."""
    return rollout(model, times, save, numerics, scheme, begin=carry, checkpoint=False)
