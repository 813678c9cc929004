"""Fits the time constant k of the pressure lag to logs: least squares, forward-mode derivatives."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from calibration.pressure_logs.read import ManifoldLog, psi
from slider_jax.actuation import FirstOrderLag, Recorded
from slider_jax.actuation.waveform import Segment

PLAUSIBLE = (0.01, 1.0)
"""Search range of k [s], from a bare valve to a long leaking hose. Chosen before measurements."""
BLOCK = 1024  # samples; the arrays of a batch are padded to a multiple of this length
_STARTS = np.linspace(np.log(PLAUSIBLE[0]), np.log(PLAUSIBLE[1]), 25)


class LogBatch(eqx.Module):
    """Logs as arrays (logs, samples) with pressures in psi. Shorter logs are padded."""

    set_point: Segment
    """Linear segments of the command between samples, (logs, samples - 1)."""
    pressure: Float[Array, "logs samples"]
    weight: Float[Array, "logs samples"]
    """1 for a sample, 0 for padding."""

    @classmethod
    def of(cls, logs: Sequence[ManifoldLog]) -> "LogBatch":
        """Returns the batch of `logs`. The padding repeats the last command with weight 0.

        The length is a multiple of `BLOCK`. Batches of equal length use the same compiled program.
        """
        longest = -(-max(len(log.t) for log in logs) // BLOCK) * BLOCK
        after = np.arange(1, longest + 1)

        def stack(values, pads):
            pairs = zip(values, pads, strict=True)
            rows = [np.concatenate([v, p[: longest - len(v)]]) for v, p in pairs]
            return jnp.asarray(np.stack(rows))

        hold = np.ones(longest)
        t = stack([log.t for log in logs], [log.t[-1] + log.period * after for log in logs])
        command = stack(
            [psi(log.command) for log in logs], [psi(log.command[-1]) * hold for log in logs]
        )
        return cls(
            jax.jit(jax.vmap(set_points))(t, command),
            stack([psi(log.pressure) for log in logs], [hold] * len(logs)),
            stack([np.ones(len(log.t)) for log in logs], [0.0 * hold] * len(logs)),
        )


def set_points(t: Float[Array, " n"], command: Float[Array, " n"]) -> Segment:
    """Returns the linear segments between the samples `command` at the times `t` [s]."""
    return jax.vmap(Recorded(t, command).segment)(t[:-1], t[1:])


def free_run(k, set_point: Segment, start) -> Float[Array, " n"]:
    """Returns the free run: the pressure that a lag with time constant `k` [s] predicts.

    The free run begins at the pressure `start` and then depends only on the command `set_point`.
    """
    law = FirstOrderLag(k)
    first = jnp.asarray(start)

    def advance(p, segment):
        p = law.advance(p, segment)
        return p, p

    _, rest = jax.lax.scan(advance, first, set_point)
    return jnp.concatenate([first[None], rest])


def residual_psi(log_k, log: LogBatch) -> Float[Array, " n"]:
    """Returns measured pressure minus free run [psi] of one log; 0 in the padding.

    `log` is one log of a `LogBatch`, so its arrays have no first axis.
    """
    return log.weight * (log.pressure - free_run(jnp.exp(log_k), log.set_point, log.pressure[0]))


class LagFit(NamedTuple):
    """The logarithm of the fitted k, and statistics of every log with this k."""

    log_k: Array
    residual: Array
    """Measured pressure minus free run (logs, samples) [psi]."""
    tangent: Array
    """Derivative (logs, samples) of the residual with respect to log k [psi]."""
    curvature: Array
    """Second derivative (logs,) of half the sum of squares with respect to log k [psi^2]."""
    converged: Array


_SOLVER: optx.AbstractLeastSquaresSolver = optx.LevenbergMarquardt(rtol=1e-7, atol=1e-7)


def _solve(residual, start, args):
    # By default, the solver stores every step of the scan. A forward-mode JVP stores no step.
    @jax.custom_jvp
    def with_tangent(x, args):
        return residual(x, args)

    @with_tangent.defjvp
    def rule(primals, tangents):
        x, args = primals
        value, slope = jax.jvp(lambda z: residual(z, args), (x,), (jnp.ones_like(x),))
        return value, slope * tangents[0]

    solution = optx.least_squares(
        with_tangent, _SOLVER, start, args=args, options={"jac": "fwd"}, max_steps=60, throw=False
    )
    return solution.value, solution.result == optx.RESULTS.successful


def _statistics(log_k, log: LogBatch):
    def slope(x):
        residual, tangent = jax.jvp(lambda z: residual_psi(z, log), (x,), (jnp.ones_like(x),))
        return residual @ tangent, (residual, tangent)

    _, curvature, (residual, tangent) = jax.jvp(
        slope, (log_k,), (jnp.ones_like(log_k),), has_aux=True
    )
    return residual, tangent, curvature


def _scaled(log_k, log: LogBatch):
    """Returns residual / sqrt(samples) [psi]. Its sum of squares is the residual's mean square."""
    return residual_psi(log_k, log) / jnp.sqrt(jnp.sum(log.weight))


def _profile(batch: LogBatch):
    """Returns the mean square (starts, logs) [psi^2] of the residual at each k of `_STARTS`."""
    each = jax.vmap(lambda x, log: jnp.sum(_scaled(x, log) ** 2), (None, 0))
    return jax.lax.map(lambda x: each(x, batch), jnp.asarray(_STARTS))


def _lowest_minimum(square):
    """Returns log k at the lowest local minimum of `square` over `_STARTS`, or else at its minimum.

    The ends of the range do not count as local minima: with a k much longer than the log, the
    pressure stays constant. A constant pressure may fit well by chance without identifying k.
    """
    inner = square[1:-1]
    is_minimum = (inner < square[:-2]) & (inner < square[2:])
    minima = jnp.where(is_minimum, inner, jnp.inf)
    index = jnp.where(jnp.any(is_minimum), 1 + jnp.argmin(minima), jnp.argmin(square))
    return jnp.asarray(_STARTS)[index]


@jax.jit
def fit_each(batch: LogBatch) -> LagFit:
    """Returns a fit with a separate k for every log, by the Levenberg-Marquardt method.

    The fit starts at the lowest local minimum of a scan of the range `PLAUSIBLE`.
    """
    start = jax.vmap(_lowest_minimum, 1)(_profile(batch))
    log_k, converged = jax.vmap(lambda x, log: _solve(_scaled, x, log))(start, batch)
    residual, tangent, curvature = jax.vmap(_statistics)(log_k, batch)
    return LagFit(log_k, residual, tangent, curvature, converged)


@jax.jit
def fit_pooled(batch: LogBatch) -> LagFit:
    """Returns a fit with one k for all logs, which minimises the mean of the logs' mean squares."""
    start = _lowest_minimum(jnp.mean(_profile(batch), axis=1))
    log_k, converged = _solve(jax.vmap(_scaled, (None, 0)), start, batch)
    residual, tangent, curvature = jax.vmap(_statistics, (None, 0))(log_k, batch)
    return LagFit(log_k, residual, tangent, curvature, converged)


@jax.jit
def residuals_at(k, batch: LogBatch) -> Float[Array, "logs samples"]:
    """Returns measured pressure minus free run [psi] of every log at a given k [s]."""
    return jax.vmap(lambda log: residual_psi(jnp.log(k), log))(batch)
