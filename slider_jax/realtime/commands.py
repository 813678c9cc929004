"""Command effects on set pressures that become known as time goes on."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from slider_jax.actuation import Held, Waveform
from slider_jax.effects import Command
from slider_jax.errors import InputError


def check_commands(commands: tuple[Command, ...], h: float, samples: int) -> None:
    """Raise `InputError` where more than the last `samples` set pressures decide on the valves'.

    Tried on random ones, `h` [s] apart: of two waves one knows what comes and all that was, the
    other what a plant knows.
    """
    length = 2 * samples + 10
    times = jnp.asarray(h * np.arange(float(length)))
    values = jnp.asarray(np.random.default_rng(0).uniform(-1e5, 1e5, length))

    def followed(commands: tuple[Command, ...], chamber: int, wave: Waveform, t: Array):
        for effect in commands:
            wave = effect.command(wave, chamber)
        return jax.vmap(wave.segment)(t[:-1], t[1:])

    @eqx.filter_jit
    def both(commands, chamber):
        def at(now):
            known = now + jnp.arange(1 - samples, 1)
            t = times[now] + h * jnp.array([0.0, 0.3, 0.9])  # before the next one
            waves = Held(times, values), Held(times[known], values[known])
            return [followed(commands, chamber, wave, t) for wave in waves]

        return jax.vmap(at)(jnp.arange(samples, 2 * samples))

    for count in range(1, len(commands) + 1):
        for chamber in (0, 1):
            whole, live = map(jax.tree.leaves, both(commands[:count], chamber))
            if not all(np.allclose(a, b, 1e-9, 1e-9) for a, b in zip(whole, live, strict=True)):
                raise InputError(
                    f"effects: {commands[count - 1].name()}: in real time the valves know nothing "
                    f"of the set pressures to come, and {h * (samples - 3):g} s of those that "
                    "were; allowed are dead times from 0 to that in all"
                )
