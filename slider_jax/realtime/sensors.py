"""Computes the readings of the sensors in real time, sample by sample."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from slider_jax.effects import Instrument, Readings


class Past(NamedTuple):
    """The last inputs and readings of an instrument, oldest first."""

    shown: Readings
    """Inputs of the instrument."""
    read: Readings
    """Readings of the instrument."""


def constant_past(effect: Instrument, first: Readings, h: float, samples: int) -> Past:
    """Returns an instrument's past with constant input: `samples` samples, `h` [s] apart."""
    held = jax.tree.map(lambda x: jnp.stack([x] * samples, axis=-1), first)
    shown = held._replace(t=first.t + h * jnp.arange(1.0 - samples, 1.0))
    return Past(shown, effect.read(shown))


def read_now(effect: Instrument, past: Past, true: Readings) -> tuple[Readings, Past]:
    """Returns the instrument's reading for the next input `true`, and the new past."""
    shown = jax.tree.map(_append, past.shown, true)
    now = effect.read_sample(shown, past.read)
    return now, Past(shown, jax.tree.map(_append, past.read, now))


def _append(series: Array, x: Array) -> Array:
    return jnp.concatenate([series[..., 1:], x[..., None]], axis=-1)


class SensorReading(NamedTuple):
    """Readings of the sensors at `t` [s], without noise."""

    t: float
    pressures: tuple[float, ...]
    """Gauge pressures [Pa] of the chambers, in the order of `Plant.chambers`."""
    signed: tuple[float, ...]
    """Signed pressure [Pa] of each pneumatic actuator, left minus right, as in the CSV columns."""
    thrust_N: float
    recoil_N: float
    tip_m: float
    ok: bool
    """False after a step that did not converge. Other fields keep the values of the step before."""
