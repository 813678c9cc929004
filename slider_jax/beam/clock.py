"""The clock of a gait whose frequency changes with time."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float


class Clock(eqx.Module):
    """Counts periods: turns(t) is the integral of the frequency from `times[0]` to t.

    The frequency is linear between its values at the `times`, and constant outside them.
    """

    times: Float[Array, " knots"]
    """Increasing times [s]; at least one."""
    frequency: Float[Array, " knots"]
    """Frequency [Hz] at the times."""

    def turns(self, t: Array) -> Array:
        """Returns the number of periods [-] at `t` [s]."""
        at, f = jnp.asarray(self.times, float), jnp.asarray(self.frequency, float)
        before, after = jnp.minimum(t - at[0], 0.0), jnp.maximum(t - at[-1], 0.0)
        outside = f[0] * before + f[-1] * after
        if at.shape[0] == 1:
            return outside
        steps = jnp.diff(at)
        whole = jnp.concatenate([jnp.zeros(1), jnp.cumsum(0.5 * (f[1:] + f[:-1]) * steps)])
        i = jnp.clip(jnp.searchsorted(at, t, side="right") - 1, 0, at.shape[0] - 2)
        u = jnp.clip(t, at[i], at[i + 1]) - at[i]
        return whole[i] + (f[i] + 0.5 * (f[i + 1] - f[i]) / steps[i] * u) * u + outside
