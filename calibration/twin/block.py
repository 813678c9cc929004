"""Simulates the rig during one block of a live stream, and returns the state for the next block.

The lag model predicts the chambers' pressures from the set pressures. The measured pressures drive
the body, so that a pneumatic fault does not change the residuals of thrust, recoil and tip.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slider_jax import observables as obs
from slider_jax.actuation import FirstOrderLag, Held, Ideal, Recorded
from slider_jax.beam.parameters import Numerics, Scalar
from slider_jax.channels import OF_BODY, ChannelSet, recorded
from slider_jax.dynamics.model import Drive, Model
from slider_jax.dynamics.pressures import advance, set_pressures, start_flow
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.dynamics.step import Carry, Snapshot, at_rest
from slider_jax.dynamics.time_schemes import SDIRK2, Scheme
from slider_jax.effects import Command, Flow, Instrument, Readings, of_place
from slider_jax.experiment.load import Experiment, lag_of, to_model
from slider_jax.experiment.schema import Trial

PARAMETERS = ("k", "K_Q", "EI_tail", "tail_length")
"""Parameters with respect to which derivatives of the readings are computed, in this order."""
HISTORY = 100
"""Number of samples before a block (set pressures, true readings) that the block's simulation uses.
At 500 Hz, 100 samples are 0.2 s, which is longer than any dead time or filter of an effect."""


class ChamberFault(Flow):
    """A fault of the chambers' pneumatics.

        dp/dt = (1 - shut) (p_set - p)/(slower k) - leak p/k

    `shut` is the blocked fraction of the valve and applies only while |p| increases. `leak` is the
    conductance of the leak divided by the conductance of the valve. `slower` is a factor on k.
    `leak` and `shut` (2,) have one value for each side of the robot: first left (side 1), then
    right (side -1).
    """

    leak: Float[Array, "2"]
    shut: Float[Array, "2"]
    slower: Scalar

    def rate(self, rate, x):
        leak, shut = (jnp.where(x.side > 0.0, y[0], y[1]) for y in (self.leak, self.shut))
        return jnp.where(x.filling, 1.0 - shut, 1.0) * rate / self.slower - leak * x.p / x.k


class FaultHypothesis(NamedTuple):
    """A possible fault with the given `size` on the left side (1), right side (-1) or both (0)."""

    cause: str
    side: int
    size: float

    @property
    def effect(self) -> ChamberFault:
        on = self.size * np.array([self.side > 0, self.side < 0], float)
        leak, shut = (on if self.cause == x else np.zeros(2) for x in ("leak", "blocked valve"))
        slower = self.size if self.cause == "slower lag" else 1.0
        return ChamberFault(jnp.asarray(leak), jnp.asarray(shut), jnp.asarray(slower))


FAULT_HYPOTHESES = (
    *(FaultHypothesis("leak", side, size) for side in (1, -1) for size in (0.15, 0.5)),
    *(FaultHypothesis("blocked valve", side, size) for side in (1, -1) for size in (0.4, 1.0)),
    FaultHypothesis("slower lag", 0, 1.3),
)


class BlockState(eqx.Module):
    """The state of the simulation at the end of a block."""

    values: Float[Array, " values"]
    """Values of `PARAMETERS` with which the state was computed."""
    p: Float[Array, "rows actuators"]
    """Pressures [Pa] that the lag model predicts from the set pressures, and states of the model's
    `Flow` effects. The rows are those of `start_flow`."""
    dp: Float[Array, "rows actuators"]
    """Derivative of `p` with respect to k."""
    sensed: Float[Array, "rows actuators"]
    """As `p`, for the pressures that drive the body: measured pressures, or predicted pressures in
    a gap."""
    faulty: Float[Array, "faults rows actuators"]
    """As `p`, for the pressures that the lag model predicts with each of `FAULT_HYPOTHESES`."""
    body: Carry
    d_body: Any
    """Derivatives of `body` with respect to all `PARAMETERS` except k, on the first axis."""
    last: Float[Array, "3"]
    """Thrust [N], recoil [N] and tip [m] at the end of the block."""
    d_last: Float[Array, "bodies 3"]
    past: Float[Array, "past channels"]
    """Last true readings, to which effects on sensors are applied; empty without such effects."""
    d_past: Float[Array, "values past channels"]


class BlockPrediction(NamedTuple):
    """The model's values at the samples of a block."""

    channels: Float[Array, "channels samples"]
    """Predicted readings, in the order of `live_channels`."""
    derivatives: Float[Array, "values channels samples"]
    """Derivatives of the readings with respect to `PARAMETERS`."""
    faulty: Float[Array, "faults actuators samples"]
    """Pressures [Pa] with each of `FAULT_HYPOTHESES`."""


@dataclass(frozen=True)
class BlockLayout:
    """Layout of a block: time `period` [s] between samples, and number of samples per time step."""

    period: float
    samples: int
    per_step: int
    numerics: Numerics
    scheme: Scheme = SDIRK2


def live_channels(experiment: Experiment) -> ChannelSet:
    """Returns the channels of the live stream: the pressures, thrust, recoil and tip."""
    return ChannelSet(experiment.channels.members[: len(experiment.chambers) + len(OF_BODY)])


def live_model(experiment: Experiment, trial: Trial) -> Model:
    """Returns a trial's model with the experiment's k and zero drive. Each block sets the drive."""
    wave = Recorded(jnp.zeros(2), jnp.zeros(2))
    model = to_model(experiment, trial)
    return replace(
        model,
        pressure_law=jax.tree.map(jnp.asarray, lag_of(experiment)),
        drive=Drive((wave,) * len(model.drive.waves), jnp.zeros(())),
    )


def parameter_values(experiment: Experiment) -> np.ndarray:
    """Returns the values (parameters,) of `PARAMETERS` in an experiment."""
    parameters, tail = experiment.parameters, experiment.robot_model().tail
    return np.array([parameters.k, parameters.K_Q, tail.effective_EI, tail.length], float)


def initial_block_state(model: Model, layout: BlockLayout, values: np.ndarray) -> BlockState:
    """Returns the state of a straight body at rest with empty chambers."""
    body = at_rest(_of_body(model, jnp.asarray(values[1:])), layout.numerics)
    count, past = len(PARAMETERS), HISTORY if of_place(model.effects, Instrument) else 0
    moving = eqx.filter(body, eqx.is_inexact_array)
    actuators = len(model.drive.waves)
    channels = actuators + len(OF_BODY)
    return BlockState(
        values=jnp.asarray(values),
        **pressure_state(model, np.zeros(actuators)),
        body=body,
        d_body=jax.tree.map(lambda x: jnp.zeros((count - 1, *x.shape)), moving),
        last=jnp.zeros(3),
        d_last=jnp.zeros((count - 1, 3)),
        past=jnp.zeros((past, channels)),
        d_past=jnp.zeros((count, past, channels)),
    )


def pressure_state(model: Model, p: np.ndarray) -> dict[str, Any]:
    """Returns the first four fields of `BlockState` except `values`, at the pressures `p` [Pa]."""
    y = start_flow(of_place(model.effects, Flow), jnp.asarray(p))
    faulty = jnp.broadcast_to(y, (len(FAULT_HYPOTHESES), *y.shape))
    return {"p": y, "dp": jnp.zeros_like(y), "sensed": y, "faulty": faulty}


def compile_block(
    model: Model, layout: BlockLayout, state: BlockState
) -> Callable[..., tuple[BlockState, BlockPrediction]]:
    """Returns the program of a block, compiled for models with the structure of `model`.

    The arguments of the program are (model, state, values (parameters,), t0, set_pressure
    (actuators, HISTORY + 1 + samples), measured pressure (actuators, samples)). `t0` [s] is the
    time of the last sample before the block. A set pressure [Pa] is the mean since the previous
    sample. A missing measured pressure is NaN.
    """

    def run(model, state, values, t0, set_pressure, measured):
        return _block(layout, model, state, values, t0, set_pressure, measured)

    n, actuators = layout.samples, len(model.drive.waves)
    arguments = (model, state, state.values, jnp.zeros(()))
    shapes = [jax.ShapeDtypeStruct((actuators, m), jnp.dtype(float)) for m in (HISTORY + 1 + n, n)]
    return jax.jit(run).lower(*arguments, *shapes).compile()


def _of_body(model: Model, values: Array) -> Model:
    """Returns the model driven by measured pressures; `values` are all `PARAMETERS` except k."""
    K_Q, EI_tail, tail_length = values
    return replace(
        model,
        robot=replace(model.robot, K_Q=K_Q).with_tail(tail_length, EI_tail),
        effects=tuple(x for x in model.effects if not isinstance(x, (Command, Flow, Instrument))),
        pressure_law=Ideal(),
    )


def _block(
    layout: BlockLayout, model: Model, state: BlockState, values, t0, set_pressure, measured
):
    state = _extrapolated(state, values)
    at = t0 + layout.period * jnp.arange(layout.samples + 1.0)
    # A chamber fills in many sample periods, so the mean set pressure of a period is sufficient.
    since = t0 + layout.period * jnp.arange(-HISTORY - 1.0, float(layout.samples))
    waves = tuple(Held(since, x) for x in set_pressure)
    assert isinstance(model.pressure_law, FirstOrderLag)
    lag = replace(model.pressure_law, k=values[0])
    state, p, dp, sensed, faulty = _pressures(
        layout, replace(model, drive=Drive(waves), pressure_law=lag), state, at, measured
    )
    as_read = Drive(tuple(Recorded(at, x) for x in sensed.T))
    state, body, d_body = _body(layout, replace(model, drive=as_read), state, t0)
    true = jnp.concatenate([p, body], axis=1)
    d_true = jnp.concatenate(
        [
            jnp.pad(dp, ((0, 0), (0, body.shape[1])))[None],
            jnp.pad(d_body, ((0, 0), (0, 0), (p.shape[1], 0))),
        ]
    )
    state, read, d_read = _instruments(layout, model, state, at[1:], true, d_true)
    return state, BlockPrediction(read.T, jnp.swapaxes(d_read, 1, 2), jnp.moveaxis(faulty, 0, -1))


def _extrapolated(state: BlockState, values) -> BlockState:
    """Returns the state for other `values` of `PARAMETERS`, by linear extrapolation."""
    change = values - state.values
    moving, rest = eqx.partition(state.body, eqx.is_inexact_array)
    moved = jax.tree.map(lambda x, d: x + jnp.tensordot(change[1:], d, 1), moving, state.d_body)
    return replace(
        state, values=values, p=state.p + change[0] * state.dp, body=eqx.combine(moved, rest)
    )


def _pressures(layout: BlockLayout, model: Model, state: BlockState, at, measured):
    """Returns the new state and four series of chamber pressures [Pa].

    The first series p (samples, actuators) are the pressures of the lag model. The second series
    (samples, actuators) is dp/dk. The third series (samples + 1, actuators) drives the body. The
    fourth series (samples, faults, actuators) are the pressures with each of `FAULT_HYPOTHESES`.
    """
    flows, law = of_place(model.effects, Flow), model.pressure_law
    faults = jax.tree.map(lambda *x: jnp.stack(x), *(x.effect for x in FAULT_HYPOTHESES))

    def body(carry, inputs):
        p, dp, sensed, faulty = carry
        segment, read = inputs
        p, dp = jax.jvp(
            lambda k, p: advance(replace(law, k=k), flows, p, segment),
            (law.k, p),
            (jnp.ones_like(law.k), dp),
        )
        sensed = advance(law, flows, sensed, segment)
        sensed = sensed.at[0].set(jnp.where(jnp.isfinite(read), read, sensed[0]))
        faulty = jax.vmap(lambda x, p: advance(law, (*flows, x), p, segment))(faults, faulty)
        after = (p, dp, sensed, faulty)
        return after, (p[0], dp[0], sensed[0], faulty[:, 0])

    carry = (state.p, state.dp, state.sensed, state.faulty)
    carry, (p, dp, sensed, faulty) = jax.lax.scan(
        body, carry, (set_pressures(model, at), measured.T)
    )
    sensed = jnp.concatenate([state.sensed[:1], sensed])
    p_end, dp_end, seen_end, faulty_end = carry
    state = replace(state, p=p_end, dp=dp_end, sensed=seen_end, faulty=faulty_end)
    return state, p, dp, sensed, faulty


def _save(x: Snapshot):
    return jnp.stack([obs.thrust(x), obs.recoil(x), obs.tip(x)])


def _body(layout: BlockLayout, model: Model, state: BlockState, t0):
    """Returns the new state, the readings (samples, 3) of thrust, recoil and tip, and derivatives.

    The derivatives (parameters, samples, 3) are with respect to all `PARAMETERS` except k.
    """
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

    def derivatives(direction, d_moving):
        return jax.jvp(run, (state.values[1:], moving), (direction, d_moving), has_aux=True)

    directions = jnp.eye(len(PARAMETERS) - 1)
    (saved, moving), (d_saved, d_moving), rest = jax.vmap(
        derivatives, out_axes=((None, None), 0, None)
    )(directions, state.d_body)

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
    """Returns the new state, the recorded readings, and the derivatives of the recorded readings.

    `true` (samples, channels) are the true readings, and `d_true` are their derivatives.
    """
    past, actuators = len(state.past), len(model.drive.waves)
    series = jnp.concatenate([state.past, true])
    d_series = jnp.concatenate([state.d_past, d_true], axis=1)
    t = at[-1] + layout.period * jnp.arange(1.0 - len(series), 1.0)

    def read(series):
        true = Readings(t, series.T[:actuators], *series.T[actuators:])
        _, pressures, *of_body = recorded(model.effects, true)
        return jnp.concatenate([pressures, jnp.stack(of_body)]).T[past:]

    d_read = jax.vmap(lambda d: jax.jvp(read, (series,), (d,))[1])(d_series)
    kept = replace(state, past=series[len(true) :], d_past=d_series[:, len(true) :])
    return kept, read(series), d_read
