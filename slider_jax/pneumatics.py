"""From set pressures to the pressures that bend the body, before the body is moved.

    set pressure -> Command effects -> pressure law and Flow effects -> p, which the sensor reads
                 -> ActingPressure effects -> the pressure that the body feels

The body does not act on the pressure, so whole histories are known before the rollout.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.actuation import FirstOrderLag, PressureLaw
from slider_jax.actuation.waveform import Segment
from slider_jax.effects import ActingPressure, Command, Flow, of_place
from slider_jax.model import Model


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
    commands = of_place(model.effects, Command)
    flows = of_place(model.effects, Flow)
    acts = of_place(model.effects, ActingPressure)

    def segments(wave, chamber):
        for effect in commands:
            wave = effect.command(wave, chamber)
        return jax.vmap(wave.segment)(times[:-1], times[1:])

    def body(before, inputs):
        dt, *set_points = inputs
        p = jnp.stack(
            [advance(model.pressure_law, flows, before.p[i], x) for i, x in enumerate(set_points)]
        )
        acting, memories = p, []
        for effect, memory in zip(acts, before.memories, strict=True):
            acting, memory = effect.act(acting, memory, dt)
            memories.append(memory)
        after = Chambers(p, acting, tuple(memories))
        return after, after

    inputs = (jnp.diff(times), segments(model.drive.front, 0), segments(model.drive.rear, 1))
    return jax.lax.scan(body, begin, inputs)[1]


def advance(law: PressureLaw, flows: tuple[Flow, ...], p: Array, x: Segment) -> Array:
    """Pressure [Pa] at the end of a segment from that at its start.

    The law's own exact step. Where effects change the flow of a lag, what they change in a step of
    the classical Runge-Kutta method is added, on either side of the set pressure's break, so that
    effects at their null change nothing.
    """
    exact = law.advance(p, x)
    if not flows or not isinstance(law, FirstOrderLag):
        return exact

    def step(flows):
        middle = _runge_kutta(law.k, flows, p, x.a0, x.a1, x.t_break - x.t0)
        return _runge_kutta(law.k, flows, middle, x.b0, x.b1, x.t1 - x.t_break)

    return exact + (step(flows) - step(()))


def _runge_kutta(k, flows, p, a0, a1, span):
    def rate(p, share):
        p_set = a0 + share * (a1 - a0)
        dp = (p_set - p) / k
        for effect in flows:
            dp = effect.rate(dp, p, p_set, k)
        return dp

    k1 = rate(p, 0.0)
    k2 = rate(p + 0.5 * span * k1, 0.5)
    k3 = rate(p + 0.5 * span * k2, 0.5)
    k4 = rate(p + span * k3, 1.0)
    return p + span / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
