"""Functions that several effects share: smooth limits, and delays and lags of sampled series."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.parameters import Scalar

LIMIT_EXPONENT = 32
"""Exponent in `limited`. For an x at the limit, the result is 2 % too small; for an x at nine
tenths of the limit, it is 0.1 % too small."""


def magnitude(x: Array, width: float) -> Array:
    """Returns |x|, rounded below `width`: sqrt(x^2 + width^2)."""
    return jnp.sqrt(x**2 + width**2)


def limited(x: Array, inverse: Array) -> Array:
    """Returns x limited to -1/inverse and 1/inverse: x/(1 + |inverse x|^32)^(1/32)."""
    return x / (1.0 + (inverse * x) ** LIMIT_EXPONENT) ** (1.0 / LIMIT_EXPONENT)


def delayed(x: Float[Array, " n"], t: Float[Array, " n"], delay: Scalar) -> Float[Array, " n"]:
    """Returns x(t - delay) at the times `t` [s]; x is constant outside `t`.

    The interpolation is cubic Hermite with central differences as slopes, so the derivative with
    respect to the delay is continuous at the samples and at zero. `delay` may be negative.
    """
    last = x.shape[0] - 1
    place = jnp.arange(last + 1.0) - delay / (t[1] - t[0])
    cell = jnp.floor(place)
    u = place - cell
    x0, x1, x2, x3 = (x[jnp.clip(cell + i, 0.0, float(last)).astype(int)] for i in (-1, 0, 1, 2))
    slope1, slope2 = 0.5 * (x2 - x0), 0.5 * (x3 - x1)
    curve = 3.0 * (x2 - x1) - 2.0 * slope1 - slope2
    twist = 2.0 * (x1 - x2) + slope1 + slope2
    return x1 + u * (slope1 + u * (curve + u * twist))


def lag_coefficients(tau: Scalar, dt: Array) -> tuple[Array, Array]:
    """Returns the decay e = exp(-dt/tau) in a step `dt` [s], and the mean decay (1 - e) tau/dt.

    At tau = 0 both are zero, and the derivative of the mean with respect to tau is 1/dt.
    """
    # For tau < dt/500 the decay is zero in float64, and the mean is tau/dt.
    slow = tau > dt / 500.0
    exponent = dt / jnp.where(slow, tau, dt)
    e = jnp.where(slow, jnp.exp(-exponent), 0.0)
    return e, jnp.where(slow, -jnp.expm1(-exponent), 1.0) * tau / dt


def lagged(
    x: Float[Array, " n"], t: Float[Array, " n"], tau: Scalar, start: Array | None = None
) -> Float[Array, " n"]:
    """Returns the solution y of tau dy/dt = x - y from y = `start` (default: the first x).

    The solution is exact if x is linear within each step. For a step, with the decay e and the mean
    decay m of `lag_coefficients`,

        y_1 = e y_0 + (1 - e) x_0 + (1 - m) (x_1 - x_0)

    At tau = 0 the result is x, and the derivative with respect to tau is -dx/dt, as for a slow x.
    """
    e, m = lag_coefficients(tau, t[1] - t[0])

    def body(y, ends):
        x_0, x_1 = ends
        # This form is x_1 minus the lag, so it is exact at tau = 0.
        y = x_1 + e * (y - x_0) - m * (x_1 - x_0)
        return y, y

    first = x[0] if start is None else start
    _, rest = jax.lax.scan(body, first, (x[:-1], x[1:]))
    return jnp.concatenate([first[None], rest])


def lagged_sample(
    x: Float[Array, " n"], t: Float[Array, " n"], tau: Scalar, y: Float[Array, " m"]
) -> Array:
    """Returns the last sample of `lagged` from the readings `y` of the previous samples."""
    return lagged(x[-2:], t[-2:], tau, y[-1])[-1]
