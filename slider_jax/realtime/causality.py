"""Checks that effects need neither future values nor older values than a `Plant` stores."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from slider_jax.actuation import Held, Waveform
from slider_jax.effects import Command, Instrument, Readings
from slider_jax.errors import InputError
from slider_jax.realtime.sensors import constant_past, read_now

LATE = 3600.0
"""Time [s] after the start at which the commands are checked. A delay may grow with time."""


def check_commands(commands: tuple[Command, ...], h: float, samples: int) -> None:
    """Raises `InputError` if the valves depend on more than the last `samples` set pressures.

    The check applies the effects to a series of random set pressures, `h` [s] apart, that begins
    an hour after the start of the run. The waveform from the last `samples` set pressures must
    equal the waveform from the whole series. A clock that is slow is late by more than these
    samples then.
    """
    length = 2 * samples + 10
    times = jnp.asarray(LATE + h * np.arange(float(length)))
    values = jnp.asarray(np.random.default_rng(0).uniform(-1e5, 1e5, length))

    def segments(commands: tuple[Command, ...], rear: Array, wave: Waveform, t: Array):
        for effect in commands:
            wave = effect.command(wave, rear)
        return jax.vmap(wave.segment)(t[:-1], t[1:])

    @eqx.filter_jit
    def both(commands, rear):
        def at(now):
            known = now + jnp.arange(1 - samples, 1)
            t = times[now] + h * jnp.array([0.0, 0.3, 0.9])  # before the next sample
            waves = Held(times, values), Held(times[known], values[known])
            return [segments(commands, rear, wave, t) for wave in waves]

        return jax.vmap(at)(jnp.arange(samples, 2 * samples))

    for count in range(1, len(commands) + 1):
        for rear in (0.0, 1.0):
            whole, live = map(jax.tree.leaves, both(commands[:count], jnp.asarray(rear)))
            if not all(np.allclose(a, b, 1e-9, 1e-9) for a, b in zip(whole, live, strict=True)):
                raise InputError(
                    f"effects: {commands[count - 1].name()}: in real time only the set pressures "
                    f"of the last {h * (samples - 3):g} s are stored; allowed is a total dead time "
                    f"of 0 to {h * (samples - 3):g} s; remove the effect"
                )


def check_instrument(effect: Instrument, pressures: int, h: float, samples: int) -> None:
    """Raises `InputError` if readings from `read_now` differ from `effect.read` of a whole series.

    The check uses a random series with steps of `h` [s] of all readings; `pressures` is their
    number of pressures. An instrument that needs future samples,
    or samples older than the last `samples`, fails the check.
    """
    t = jnp.asarray(h * np.arange(2.0 * samples + 50.0))
    noise = np.random.default_rng(0).normal(size=(pressures + 3, len(t)))
    series = Readings(t, jnp.asarray(noise[:pressures]), *jnp.asarray(noise[pressures:]))

    @jax.jit
    def both(effect, series):
        first = jax.tree.map(lambda x: x[..., 0], series)
        rest = jax.tree.map(lambda x: jnp.moveaxis(x[..., 1:], -1, 0), series)

        def body(past, true):
            now, past = read_now(effect, past, true)
            return past, now

        live = jax.lax.scan(body, constant_past(effect, first, h, samples), rest)[1]
        return effect.read(series), jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1), live)

    whole, live = both(effect, series)
    for expected, reading in zip(whole[1:], live[1:], strict=True):
        # The last samples are excluded: their delayed readings differ, since no samples follow.
        error = np.abs(np.asarray(reading) - np.asarray(expected)[..., 1:])[..., :-4]
        if not error.max() < 1e-9 * np.abs(expected).max():
            raise InputError(
                f"effects: {effect.name()}: in real time only values of the last {h * samples:g} s "
                f"are stored; allowed is a delay of 0, or of {h:g} s (one step) to "
                f"{h * (samples - 3):g} s; remove the effect, or simulate the whole trial"
            )
