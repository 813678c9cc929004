"""One block of a live stream through the model: compiled once, its state carried from call to call.

Both chambers run freely from their set pressures; the body is driven by what the pressure sensors
read. So a fault of the pressures does not show as one of the body, and the lag is judged by the
pressures alone.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from calibration.twin.faults import SUSPECTS
from slider_jax import observables as obs
from slider_jax.actuation import FirstOrderLag, Held, Ideal, Recorded
from slider_jax.beam.parameters import Numerics
from slider_jax.channels import BUILT_IN, recorded
from slider_jax.dynamics.model import Drive, Model
from slider_jax.dynamics.pressures import advance, set_pressures
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.dynamics.step import Carry, Snapshot, at_rest
from slider_jax.dynamics.time_schemes import SDIRK2, Scheme
from slider_jax.effects import Command, Flow, Instrument, Readings, of_place
from slider_jax.experiment.load import Experiment, to_model
from slider_jax.experiment.schema import Trial

VALUES = ("k", "K_Q", "EI_tail", "tail_length")
"""Parameters along which the model's tangents are taken, in this order; the first is the lag's."""
PAST = 100
"""Samples of set pressures, and of what instruments read, kept from before a block: longer than
any dead time or filter of the library at 500 Hz."""


class BlockState(eqx.Module):
    """What one block hands to the next."""

    values: Float[Array, " values"]
    """`VALUES` that the state was found with."""
    p: Float[Array, "2"]
    """Of the lag model, running freely [Pa]."""
    dp: Float[Array, "2"]
    """Its derivative to k."""
    seen: Float[Array, "2"]
    """Pressures that drive the body [Pa]: as read, over a gap by the lag from the last reading."""
    faulty: Float[Array, "suspects 2"]
    """As `p`, with each of `SUSPECTS`."""
    body: Carry
    d_body: Any
    """Derivatives of `body` to all `VALUES` but k, on a leading axis."""
    last: Float[Array, "3"]
    """thrust, recoil [N], tip [m] at the block's end."""
    d_last: Float[Array, "bodies 3"]
    past: Float[Array, "past 5"]
    """Before the instruments; empty if there are none."""
    d_past: Float[Array, "values past 5"]


class Predicted(NamedTuple):
    """The model at the samples of a block."""

    channels: Float[Array, "5 samples"]
    """`BUILT_IN`."""
    along: Float[Array, "values 5 samples"]
    """Derivatives to `VALUES`."""
    faulty: Float[Array, "suspects 2 samples"]
    """Pressures [Pa] that each of `SUSPECTS` would make."""


@dataclass(frozen=True)
class BlockLayout:
    """`samples` a block, `period` [s] apart, every `per_step` of them a step of the body."""

    period: float
    samples: int
    per_step: int
    numerics: Numerics
    scheme: Scheme = SDIRK2


def live_model(experiment: Experiment, trial: Trial) -> Model:
    """A trial's model with the experiment's lag; its drive is to come from the stream."""
    wave = Recorded(jnp.zeros(2), jnp.zeros(2))
    return replace(
        to_model(experiment, trial),
        pressure_law=FirstOrderLag(jnp.asarray(experiment.parameters.k)),
        drive=Drive(wave, wave, jnp.zeros(()), jnp.zeros(())),
    )


def values_of(experiment: Experiment) -> np.ndarray:
    """`VALUES` of an experiment."""
    parameters, robot = experiment.parameters, experiment.robot
    return np.array([parameters.k, parameters.K_Q, robot.EI_tail, robot.tail_length])


def initial_block_state(model: Model, layout: BlockLayout, values: np.ndarray) -> BlockState:
    """Straight and at rest, chambers empty."""
    body = at_rest(_of_body(model, jnp.asarray(values[1:])), layout.numerics)
    count, past = len(VALUES), PAST if of_place(model.effects, Instrument) else 0
    moving = eqx.filter(body, eqx.is_inexact_array)
    zero = jnp.zeros(2)
    return BlockState(
        values=jnp.asarray(values),
        p=zero,
        dp=zero,
        seen=zero,
        faulty=jnp.zeros((len(SUSPECTS), 2)),
        body=body,
        d_body=jax.tree.map(lambda x: jnp.zeros((count - 1, *x.shape)), moving),
        last=jnp.zeros(3),
        d_last=jnp.zeros((count - 1, 3)),
        past=jnp.zeros((past, len(BUILT_IN))),
        d_past=jnp.zeros((count, past, len(BUILT_IN))),
    )


def compiled(
    model: Model, layout: BlockLayout, state: BlockState
) -> Callable[..., tuple[BlockState, Predicted]]:
    """The program of a block, compiled for models of this structure.

    It takes (model, state, values (4,), t0, set_pressure (2, PAST + 1 + samples), measured pressure
    (2, samples)): `t0` [s] is the last sample before the block, set pressures [Pa] are means since
    the sample before and end with the block's last one, NaN stands for a pressure that was not
    read.
    """

    def run(model, state, values, t0, set_pressure, measured):
        return _block(layout, model, state, values, t0, set_pressure, measured)

    n = layout.samples
    arguments = (model, state, state.values, jnp.zeros(()))
    shapes = [jax.ShapeDtypeStruct((2, m), jnp.dtype(float)) for m in (PAST + 1 + n, n)]
    return jax.jit(run).lower(*arguments, *shapes).compile()


def _of_body(model: Model, values: Array) -> Model:
    """The model driven by pressures at the sensor, with all `VALUES` but k."""
    K_Q, EI_tail, tail_length = values
    return replace(
        model,
        robot=replace(model.robot, K_Q=K_Q, EI_tail=EI_tail, tail_length=tail_length),
        effects=tuple(x for x in model.effects if not isinstance(x, (Command, Flow, Instrument))),
        pressure_law=Ideal(),
    )


def _block(
    layout: BlockLayout, model: Model, state: BlockState, values, t0, set_pressure, measured
):
    state = _moved(state, values)
    at = t0 + layout.period * jnp.arange(layout.samples + 1.0)
    # A chamber takes several periods: what it makes of an edge is told by the mean over a period.
    since = t0 + layout.period * jnp.arange(-PAST - 1.0, float(layout.samples))
    front, rear = (Held(since, x) for x in set_pressure)
    lag = FirstOrderLag(values[0])
    state, p, dp, seen, faulty = _pressures(
        layout, replace(model, drive=Drive(front, rear), pressure_law=lag), state, at, measured
    )
    as_read = Drive(Recorded(at, seen[:, 0]), Recorded(at, seen[:, 1]))
    state, body, d_body = _body(layout, replace(model, drive=as_read), state, t0)
    true = jnp.concatenate([p, body], axis=1)
    d_true = jnp.concatenate(
        [
            jnp.pad(dp, ((0, 0), (0, 3)))[None],
            jnp.pad(d_body, ((0, 0), (0, 0), (2, 0))),
        ]
    )
    state, read, d_read = _instruments(layout, model, state, at[1:], true, d_true)
    return state, Predicted(read.T, jnp.swapaxes(d_read, 1, 2), jnp.moveaxis(faulty, 0, -1))


def _moved(state: BlockState, values) -> BlockState:
    """The state to first order at other `VALUES`."""
    change = values - state.values
    moving, rest = eqx.partition(state.body, eqx.is_inexact_array)
    moved = jax.tree.map(lambda x, d: x + jnp.tensordot(change[1:], d, 1), moving, state.d_body)
    return replace(
        state, values=values, p=state.p + change[0] * state.dp, body=eqx.combine(moved, rest)
    )


def _pressures(layout: BlockLayout, model: Model, state: BlockState, at, measured):
    """The state; p, dp/dk (samples, 2), seen (samples + 1, 2), faulty (samples, suspects, 2)."""
    flows, law = of_place(model.effects, Flow), model.pressure_law
    faults = jax.tree.map(lambda *x: jnp.stack(x), *(x.effect for x in SUSPECTS))

    def body(carry, inputs):
        p, dp, seen, faulty = carry
        segment, read = inputs
        p, dp = jax.jvp(
            lambda k, p: advance(FirstOrderLag(k), flows, p, segment),
            (law.k, p),
            (jnp.ones_like(law.k), dp),
        )
        seen = jnp.where(jnp.isfinite(read), read, advance(law, flows, seen, segment))
        faulty = jax.vmap(lambda x, p: advance(law, (*flows, x), p, segment))(faults, faulty)
        after = (p, dp, seen, faulty)
        return after, after

    carry = (state.p, state.dp, state.seen, state.faulty)
    carry, (p, dp, seen, faulty) = jax.lax.scan(body, carry, (set_pressures(model, at), measured.T))
    seen = jnp.concatenate([state.seen[None], seen])
    p_end, dp_end, seen_end, faulty_end = carry
    state = replace(state, p=p_end, dp=dp_end, seen=seen_end, faulty=faulty_end)
    return state, p, dp, seen, faulty


def _save(x: Snapshot):
    return jnp.stack([obs.thrust(x), obs.recoil(x), obs.tip(x)])


def _body(layout: BlockLayout, model: Model, state: BlockState, t0):
    """The state, thrust, recoil, tip (samples, 3), and their derivatives (bodies, samples, 3)."""
    times = TimeGrid(
        jnp.asarray(layout.period * layout.per_step), layout.samples // layout.per_step, t0
    )
    moving, rest = eqx.partition(state.body, eqx.is_inexact_array)

    def run(values, moving):
        out = rollout(
            _of_body(model, values), times, _save, layout.numerics, layout.scheme,
            begin=eqx.combine(moving, rest), checkpoint=False,
        )  # fmt: skip
        moving_on, rest_on = eqx.partition(out.final, eqx.is_inexact_array)
        return (out.saved, moving_on), rest_on

    def along(direction, d_moving):
        return jax.jvp(run, (state.values[1:], moving), (direction, d_moving), has_aux=True)

    directions = jnp.eye(len(VALUES) - 1)
    (saved, moving), (d_saved, d_moving), rest = jax.vmap(along, out_axes=((None, None), 0, None))(
        directions, state.d_body
    )

    def at_samples(last, saved):
        ends = jnp.concatenate([last[None], saved])
        share = jnp.arange(1.0, layout.per_step + 1.0) / layout.per_step
        between = ends[:-1, None] + share[:, None] * (ends[1:] - ends[:-1])[:, None]
        return between.reshape(-1, 3)

    body = at_samples(state.last, saved)
    d_body = jax.vmap(at_samples)(state.d_last, d_saved)
    state = replace(
        state,
        body=eqx.combine(moving, rest),
        d_body=d_moving,
        last=saved[-1],
        d_last=d_saved[:, -1],
    )
    return state, body, d_body


def _instruments(layout: BlockLayout, model: Model, state: BlockState, at, true, d_true):
    """The state, and what the instruments make of `true` (samples, 5) and its derivatives."""
    past = len(state.past)
    series = jnp.concatenate([state.past, true])
    d_series = jnp.concatenate([state.d_past, d_true], axis=1)
    t = at[-1] + layout.period * jnp.arange(1.0 - len(series), 1.0)

    def read(series):
        return jnp.stack(recorded(model.effects, Readings(t, *series.T))[1:], axis=1)[past:]

    d_read = jax.vmap(lambda d: jax.jvp(read, (series,), (d,))[1])(d_series)
    kept = replace(state, past=series[len(true) :], d_past=d_series[:, len(true) :])
    return kept, read(series), d_read
