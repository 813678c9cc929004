"""Instruments sample by sample: what they read now, from what they were shown and read before."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from slider_jax.effects import Instrument, Readings
from slider_jax.effects.sensors.force_resonance import ForceResonance
from slider_jax.effects.sensors.force_sensor_lag import ForceSensorLag
from slider_jax.effects.sensors.pressure_sensor_lag import PressureSensorLag
from slider_jax.effects.sensors.series import lagged
from slider_jax.errors import InputError


class Past(NamedTuple):
    """What an instrument was shown and what it read, at the last samples, oldest first."""

    shown: Readings
    read: Readings


def constant_past(effect: Instrument, first: Readings, h: float, samples: int) -> Past:
    """`samples` samples, `h` [s] apart, of an instrument that has been shown `first` for long."""
    held = jax.tree.map(lambda x: jnp.broadcast_to(x, (samples,)), first)
    shown = held._replace(t=first.t + h * jnp.arange(1.0 - samples, 1.0))
    return Past(shown, effect.read(shown))


def read_now(effect: Instrument, past: Past, true: Readings) -> tuple[Readings, Past]:
    """What the instrument reads of `true`, scalars one sample later, and the new past."""
    shown = jax.tree.map(_append, past.shown, true)
    if not isinstance(effect, (ForceSensorLag, PressureSensorLag, ForceResonance)):
        now = jax.tree.map(lambda x: x[-1], effect.read(shown))  # from what it is shown alone
    else:
        pressure = isinstance(effect, PressureSensorLag)
        names = ("p_front", "p_rear") if pressure else ("thrust", "recoil")
        now = true._replace(**{name: _follow(effect, past, shown, name) for name in names})
    return now, Past(shown, jax.tree.map(_append, past.read, now))


def _follow(effect: Instrument, past: Past, shown: Readings, name: str) -> Array:
    """The reading of one channel that follows from the readings before."""
    x, y, t = getattr(shown, name), getattr(past.read, name), shown.t
    if isinstance(effect, ForceResonance):
        return effect.follow((y[-1], y[-2], y[-3]), x[-1], t[-1] - t[-2])
    assert isinstance(effect, (ForceSensorLag, PressureSensorLag))
    return lagged(x[-2:], t[-2:], effect.tau, y[-1])[-1]


def _append(series: Array, x: Array) -> Array:
    return jnp.concatenate([series[1:], x[None]])


def check_instrument(effect: Instrument, h: float, samples: int) -> None:
    """Raise `InputError` where `read_now` would not read what the instrument makes of a series.

    Tried on a random one: an instrument that looks ahead, or farther back than `samples` samples,
    is found by what it reads.
    """
    t = jnp.asarray(h * np.arange(2.0 * samples + 50.0))
    noise = np.random.default_rng(0).normal(size=(5, len(t)))
    series = Readings(t, *jnp.asarray(noise))

    @jax.jit
    def both(effect, series):
        first = jax.tree.map(lambda x: x[0], series)
        rest = jax.tree.map(lambda x: x[1:], series)

        def body(past, true):
            now, past = read_now(effect, past, true)
            return past, now

        live = jax.lax.scan(body, constant_past(effect, first, h, samples), rest)[1]
        return effect.read(series), live

    whole, live = both(effect, series)
    for expected, found in zip(whole[1:], live[1:], strict=True):
        # A delay reads the last samples of a series otherwise, as none follow.
        off = np.abs(np.asarray(found) - np.asarray(expected)[1:])[:-4]
        if not off.max() < 1e-9 * np.abs(expected).max():
            raise InputError(
                f"effects: {effect.name()}: in real time a sensor knows nothing of what comes, and "
                f"{h * samples:g} s of what was; allowed delays are 0, or {h:g} s (a step) to "
                f"{h * (samples - 3):g} s; leave it out, or simulate the trial as a whole"
            )
