"""Set pressures that become known as time goes on, and the command effects that act on them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slider_jax.actuation import Waveform
from slider_jax.actuation.waveform import Segment
from slider_jax.effects import Command
from slider_jax.errors import InputError


class Held(Waveform):
    """Set pressures [Pa] from the times [s] on at which they were given, each until the next.

    Exact for steps no longer than their spacing. Where two neighbours are equal there is no break,
    as in a wave that does not change; derivatives to single values are therefore not to be had.
    """

    times: Float[Array, " samples"]
    values: Float[Array, " samples"]

    def segment(self, t0, t1):
        last = self.times.shape[0] - 1
        here = jnp.searchsorted(self.times, t0, side="right") - 1
        here = jnp.clip(here, 0, last)
        coming = jnp.minimum(here + 1, last)
        before, after = self.values[here], self.values[coming]
        breaks = (before != after) & (self.times[coming] < t1)
        t_break = jnp.where(breaks, self.times[coming], t1)
        after = jnp.where(breaks, after, before)
        return Segment(t0, t_break, t1, before, before, after, after)


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
            t = times[now] + h * jnp.array([0.0, 0.3, 1.0])
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
