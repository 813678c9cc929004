"""From set pressures to the pressures that bend the body, before the body is moved.

    set pressure -> Command effects -> pressure law and Flow effects -> p, which the sensor reads
                 -> ActingPressure effects -> the pressure that the body feels

The body does not act on the pressure, so whole histories are known before the rollout.
"""

import functools as ft

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slider_jax.actuation import FirstOrderLag, PressureLaw
from slider_jax.actuation.waveform import Segment
from slider_jax.dynamics.model import Model
from slider_jax.effects import ActingPressure, Chamber, Command, Flow, of_place

REAR = np.array([0.0, 1.0])
"""Which of the two chambers is the rear one."""


class Chambers(eqx.Module):
    """The two chambers at one instant, front and rear."""

    p: Float[Array, "2"]
    """At the sensor [Pa]."""
    acting: Float[Array, "2"]
    """What bends the body [Pa]."""
    memories: tuple[Float[Array, "2 2"], ...] = ()
    """Of the effects that are acting pressures, in their order: own state, pressure before."""


def start_chambers(model: Model) -> Chambers:
    """The chambers at the pressures that the drive starts from, long at rest."""
    drive = model.drive
    p = jnp.stack([jnp.asarray(x, float) for x in (drive.start_front, drive.start_rear)])
    return Chambers(p, p, tuple(jnp.stack([p, p]) for _ in of_place(model.effects, ActingPressure)))


def chamber_history(model: Model, begin: Chambers, times: Float[Array, " n"]) -> Chambers:
    """The chambers (n - 1, ...) at each of the increasing `times` [s] after the first."""
    flows = of_place(model.effects, Flow)
    acts = of_place(model.effects, ActingPressure)

    def body(before, inputs):
        dt, segment = inputs
        p = advance(model.pressure_law, flows, before.p, segment)
        acting, memories = p, []
        for effect, memory in zip(acts, before.memories, strict=True):
            acting, memory = effect.act(acting, memory, dt)
            memories.append(memory)
        after = Chambers(p, acting, tuple(memories))
        return after, after

    return jax.lax.scan(body, begin, (jnp.diff(times), set_pressures(model, times)))[1]


def set_pressures(model: Model, times: Float[Array, " n"]) -> Segment:
    """What the valves of front and rear follow between the `times` [s]: entries (n - 1, 2)."""
    commands = of_place(model.effects, Command)

    def segments(wave, chamber):
        for effect in commands:
            wave = effect.command(wave, chamber)
        return jax.vmap(wave.segment)(times[:-1], times[1:])

    both = (segments(model.drive.front, 0), segments(model.drive.rear, 1))
    return jax.tree.map(lambda *x: jnp.stack(x, 1), *both)


def advance(
    law: PressureLaw, flows: tuple[Flow, ...], p: Float[Array, "2"], x: Segment
) -> Float[Array, "2"]:
    """Pressures [Pa] of front and rear at the end of their segments from those at the start.

    The law's own exact step. Where effects change the flow of a lag, what they change in a step of
    the classical Runge-Kutta method is added, so that effects at their null change nothing. Steps
    are split at the set pressure's break and where the pressure passes through zero: there a
    chamber that was vented begins to be filled.
    """
    exact = law.advance(p, x)
    if not flows or not isinstance(law, FirstOrderLag):
        return exact

    def part(p, inputs):
        with_them, without = p
        return (
            _through_zero(law.k, flows, with_them, *inputs),
            _through_zero(law.k, (), without, *inputs),
        ), None

    parts = (
        jnp.stack([x.a0, x.b0]),
        jnp.stack([x.a1, x.b1]),
        jnp.stack([x.t_break - x.t0, x.t1 - x.t_break]),
    )
    changed, plain = jax.lax.scan(part, (p, p), parts)[0]
    replaced = ft.reduce(jnp.logical_or, [flow.replaces() for flow in flows])
    return jnp.where(replaced, changed, exact + (changed - plain))


def _rate(k, flows, side):
    def rate(p, p_set):
        dp = (p_set - p) / k
        for effect in flows:
            dp = effect.rate(dp, Chamber(p, p_set, k, REAR, side))
        return dp

    return rate


def _through_zero(k, flows, p, a0, a1, span):
    """A step of `_runge_kutta`, in two parts where the pressure changes its sign."""
    rate = _rate(k, flows, jnp.where(p == 0.0, jnp.sign(a0 + a1), jnp.sign(p)))
    whole = _runge_kutta(rate, p, a0, a1, span)
    crosses = p * whole < 0.0
    share = jnp.where(crosses, p / jnp.where(crosses, p - whole, 1.0), 1.0)
    there = a0 + share * (a1 - a0)
    near = _runge_kutta(rate, p, a0, there, share * span)
    slope = span * rate(near, there)
    moves = crosses & (slope != 0.0)
    share = share - jnp.where(moves, near / jnp.where(moves, slope, 1.0), 0.0)
    share = jnp.clip(share, 0.0, 1.0)
    there = a0 + share * (a1 - a0)
    beyond = _rate(k, flows, jnp.sign(whole))
    rest = _runge_kutta(beyond, jnp.zeros_like(p), there, a1, (1.0 - share) * span)
    return jnp.where(crosses, rest, whole)


def _runge_kutta(rate, p, a0, a1, span):
    middle = 0.5 * (a0 + a1)
    k1 = rate(p, a0)
    k2 = rate(p + 0.5 * span * k1, middle)
    k3 = rate(p + 0.5 * span * k2, middle)
    k4 = rate(p + span * k3, a1)
    return p + span / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
