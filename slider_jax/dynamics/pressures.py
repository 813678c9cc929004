"""Computes the chamber pressures from the set pressures.

    set pressure -> Command effects -> pressure law and Flow effects -> p at the pressure sensor
                 -> ActingPressure effects -> pressure that bends the body

A rollout computes them before its first time step, since the body's motion does not affect them.
"""

import functools as ft
from collections.abc import Hashable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slider_jax.actuation import FirstOrderLag, PressureLaw, rear_of
from slider_jax.actuation.waveform import Segment
from slider_jax.dynamics.model import Model
from slider_jax.effects import ActingPressure, Chamber, Command, Flow, of_place


class Chambers(eqx.Module):
    """The chambers at one instant, from the head to the tail."""

    p: Float[Array, " chambers"]
    """Pressure [Pa] at the sensor."""
    acting: Float[Array, " chambers"]
    """Pressure [Pa] that bends the body."""
    flow_states: Float[Array, "states chambers"] | None = None
    """States of all `Flow` effects, in the order of the effects. None: there are no states."""
    memories: tuple[Float[Array, "2 chambers"], ...] = ()
    """The memory of each `ActingPressure` effect: its state and the previous pressure [Pa]."""


def start_chambers(model: Model) -> Chambers:
    """Returns the chambers in equilibrium at the initial pressures of the drive."""
    p = jnp.broadcast_to(jnp.asarray(model.drive.start, float), (len(model.drive.waves),))
    memories = tuple(jnp.stack([p, p]) for _ in of_place(model.effects, ActingPressure))
    y = start_flow(of_place(model.effects, Flow), p)
    return Chambers(p, p, y[1:] if len(y) > 1 else None, memories)


def chamber_history(model: Model, begin: Chambers, times: Float[Array, " n"]) -> Chambers:
    """Returns the chambers at `times[1:]` [s], from `begin` at `times[0]`; arrays (n - 1, ...)."""
    flows = of_place(model.effects, Flow)
    acting_effects = of_place(model.effects, ActingPressure)

    def body(before, inputs):
        dt, segment = inputs
        p, states = before.p, before.flow_states
        y = p[None] if states is None else jnp.concatenate([p[None], states])
        y = advance(model.pressure_law, flows, y, segment)
        acting, memories = y[0], []
        for effect, memory in zip(acting_effects, before.memories, strict=True):
            acting, memory = effect.act(acting, memory, dt)
            memories.append(memory)
        after = Chambers(y[0], acting, None if states is None else y[1:], tuple(memories))
        return after, after

    return jax.lax.scan(body, begin, (jnp.diff(times), set_pressures(model, times)))[1]


def set_pressures(model: Model, times: Float[Array, " n"]) -> Segment:
    """Returns the set pressures between `times` [s]; each field is (n - 1, chambers).

    Waves of the same kind are computed together, so that the number of chambers does not change the
    size of the program.
    """
    commands = of_place(model.effects, Command)
    waves, rear = model.drive.waves, rear_of(len(model.drive.waves))

    def segments(wave, rear):
        for effect in commands:
            wave = effect.command(wave, rear)
        return jax.vmap(wave.segment)(times[:-1], times[1:])

    if not waves:
        none = jnp.zeros((times.shape[0] - 1, 0))
        return Segment(*(none,) * 7)
    kinds: dict[Hashable, list[int]] = {}
    for i, wave in enumerate(waves):
        leaves, structure = jax.tree.flatten(wave)
        kinds.setdefault((structure, *map(jnp.shape, leaves)), []).append(i)
    parts = []
    for members in kinds.values():
        alike = jax.tree.map(lambda *x: jnp.stack(x), *(waves[i] for i in members))
        parts.append(jax.vmap(segments, out_axes=1)(alike, jnp.asarray(rear[members])))
    joined = jax.tree.map(lambda *x: jnp.concatenate(x, axis=1), *parts)
    order = np.argsort([i for members in kinds.values() for i in members])
    return joined if len(kinds) == 1 else jax.tree.map(lambda x: x[:, order], joined)


def start_flow(
    flows: tuple[Flow, ...], p: Float[Array, " chambers"]
) -> Float[Array, "1+states chambers"]:
    """Returns the pressures `p` [Pa] and the states of `flows` in equilibrium at these pressures.

    The first row is p. The other rows are the states, in the order of the effects.
    """
    return jnp.concatenate([p[None], *(effect.start(p) for effect in flows)])


def advance(
    law: PressureLaw, flows: tuple[Flow, ...], y: Float[Array, "1+states chambers"], x: Segment
) -> Float[Array, "1+states chambers"]:
    """Returns the pressures [Pa] and the states of `flows` at the end of the segment `x`.

    `y` are the pressures and states at the start of the segment, as from `start_flow`. The pressure
    law has an exact solution. For `FirstOrderLag` with `Flow` effects, the difference of two
    Runge-Kutta steps, with and without these effects, is added to this solution. Effects at their
    null thus change nothing. If an effect replaces the law, the step with effects is the result.
    Both steps are split at the break of the set pressure and at zero pressure, where the opposite
    air chamber starts to fill.
    """
    exact = law.advance(y[0], x)
    if not flows or not isinstance(law, FirstOrderLag):
        return jnp.concatenate([exact[None], y[1:]])

    def part(y, inputs):
        changed, plain = y
        return (
            _through_zero(law.time_constants, flows, changed, *inputs),
            _through_zero(law.time_constants, (), plain, *inputs),
        ), None

    parts = (
        jnp.stack([x.a0, x.b0]),
        jnp.stack([x.a1, x.b1]),
        jnp.stack([x.t_break - x.t0, x.t1 - x.t_break]),
    )
    changed, plain = jax.lax.scan(part, (y, y[:1]), parts)[0]
    replaced = ft.reduce(jnp.logical_or, [flow.replaces() for flow in flows])
    p = jnp.where(replaced, changed[:1], exact[None] + (changed[:1] - plain))
    return jnp.concatenate([p, changed[1:]])


def _rate(k, flows, side):
    """Returns a function of (y, p_set) that returns dy/dt, with the pressures in the first row."""

    def rate(y, p_set):
        dp, rows, first = (p_set - y[0]) / k, [], 1
        for effect in flows:
            own = y[first : first + effect.states]
            x = Chamber(y[0], p_set, k, rear_of(y.shape[1]), side, own)
            rows.append(effect.state_rates(dp, x))
            dp, first = effect.rate(dp, x), first + effect.states
        return jnp.concatenate([dp[None], *rows])

    return rate


def _through_zero(k, flows, y, a0, a1, span):
    """Returns y after a Runge-Kutta step that is split at zero pressure.

    The flow into a chamber may depend on the other pressures. If only one chamber crosses zero, its
    split step therefore uses the pressures of the others at the same time. The steps of the others
    are not split. If several chambers cross zero, each split step uses the pressures that the
    others have at their own zero crossings.
    """
    p = y[0]
    rate = _rate(k, flows, jnp.where(p == 0.0, jnp.sign(a0 + a1), jnp.sign(p)))
    whole = _runge_kutta(rate, y, a0, a1, span)
    crosses = p * whole[0] < 0.0

    def together(share):
        return jnp.where(crosses, share, jnp.min(jnp.where(crosses, share, 1.0)))

    share = together(jnp.where(crosses, p / jnp.where(crosses, p - whole[0], 1.0), 1.0))
    at_zero = a0 + share * (a1 - a0)
    near = _runge_kutta(rate, y, a0, at_zero, share * span)
    slopes = span * rate(near, at_zero)
    moves = crosses & (slopes[0] != 0.0)
    first = share
    share = share - jnp.where(moves, near[0] / jnp.where(moves, slopes[0], 1.0), 0.0)
    share = together(jnp.clip(share, 0.0, 1.0))
    at_zero = a0 + share * (a1 - a0)
    beyond = _rate(k, flows, jnp.sign(whole[0]))
    middle = near + (share - first) * slopes
    middle = middle.at[0].set(jnp.where(crosses, 0.0, middle[0]))
    rest = _runge_kutta(beyond, middle, at_zero, a1, (1.0 - share) * span)
    return jnp.where(crosses, rest, whole)


def _runge_kutta(rate, y, a0, a1, span):
    """Returns y after a classical Runge-Kutta step.

    The loop over the stages contains `rate` once, so that a program with many effects of the flow
    compiles faster.
    """

    def stage(carry, inputs):
        slope, total = carry
        share, weight = inputs
        slope = rate(y + share * span * slope, a0 + share * (a1 - a0))
        return (slope, total + weight * slope), None

    shares, weights = np.array([0.0, 0.5, 0.5, 1.0]), np.array([1.0, 2.0, 2.0, 1.0]) / 6.0
    stages = jnp.asarray(shares, y.dtype), jnp.asarray(weights, y.dtype)
    (_, mean), _ = jax.lax.scan(stage, (jnp.zeros_like(y), jnp.zeros_like(y)), stages)
    return y + span * mean
