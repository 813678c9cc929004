"""The pressure lag k from logs: free run and least squares by gradient."""

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
"""Range of k [s] that is searched, set before looking at data: a valve to a leaking long hose."""
BLOCK = 1024
_STARTS = np.linspace(np.log(PLAUSIBLE[0]), np.log(PLAUSIBLE[1]), 25)


class Batch(eqx.Module):
    """Logs side by side, padded to the longest: arrays (logs, samples), in psi."""

    set_point: Segment
    """What the command does between samples: (logs, samples - 1)."""
    pressure: Float[Array, "logs samples"]
    there: Float[Array, "logs samples"]
    """1 where there is a sample, 0 in the padding."""

    @classmethod
    def of(cls, logs: Sequence[ManifoldLog]) -> "Batch":
        """The batch of `logs`; the padding holds the last command and weighs nothing.

        Padded to a whole number of `BLOCK`s, so that sets of similar logs share compiled programs.
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
    """What a sampled command does between its samples: linear."""
    return jax.vmap(Recorded(t, command).segment)(t[:-1], t[1:])


def free_run(k, set_point: Segment, start) -> Float[Array, " n"]:
    """Pressure that a lag of `k` [s] makes of the command from `start` on, in the command's unit.

    The measurement enters at the first sample only.
    """
    law = FirstOrderLag(k)
    first = jnp.asarray(start)

    def advance(p, segment):
        p = law.advance(p, segment)
        return p, p

    _, rest = jax.lax.scan(advance, first, set_point)
    return jnp.concatenate([first[None], rest])


def residual_psi(log_k, log: Batch) -> Float[Array, " n"]:
    """Measured minus free run [psi] of one log (a `Batch` without its first axis); 0 in padding."""
    return log.there * (log.pressure - free_run(jnp.exp(log_k), log.set_point, log.pressure[0]))


class LagFit(NamedTuple):
    """log k, and at that k what every log says: arrays (logs, samples) and (logs,)."""

    log_k: Array
    residual: Array
    """Measured minus free run [psi]."""
    tangent: Array
    """Its derivative to log k [psi]."""
    curvature: Array
    """Second derivative to log k of half the sum of squares [psi^2]."""
    converged: Array


_SOLVER: optx.AbstractLeastSquaresSolver = optx.LevenbergMarquardt(rtol=1e-7, atol=1e-7)


def _solve(residual, start, args):
    # Linearising the scan would store every step of it; one tangent beside it stores nothing.
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


def _statistics(log_k, log: Batch):
    def slope(x):
        residual, tangent = jax.jvp(lambda z: residual_psi(z, log), (x,), (jnp.ones_like(x),))
        return residual @ tangent, (residual, tangent)

    _, curvature, (residual, tangent) = jax.jvp(
        slope, (log_k,), (jnp.ones_like(log_k),), has_aux=True
    )
    return residual, tangent, curvature


def _scaled(log_k, log: Batch):
    """The residual whose sum of squares is the mean square over the log's samples."""
    return residual_psi(log_k, log) / jnp.sqrt(jnp.sum(log.there))


def _profile(batch: Batch):
    """Mean square [psi^2] at each start: shape (starts, logs)."""
    each = jax.vmap(lambda x, log: jnp.sum(_scaled(x, log) ** 2), (None, 0))
    return jax.lax.map(lambda x: each(x, batch), jnp.asarray(_STARTS))


def _lowest_dip(square):
    """The start with the lowest mean square among those lower than both neighbours, else of all.

    A lag that is longer than the log only keeps the starting pressure, which may fit well for a
    start near the mean, and says nothing of the lag: the edge of the range is no dip.
    """
    inner = square[1:-1]
    dip = (inner < square[:-2]) & (inner < square[2:])
    dips = jnp.where(dip, inner, jnp.inf)
    index = jnp.where(jnp.any(dip), 1 + jnp.argmin(dips), jnp.argmin(square))
    return jnp.asarray(_STARTS)[index]


@jax.jit
def fit_each(batch: Batch) -> LagFit:
    """k of every log by itself.

    Levenberg-Marquardt on forward tangents, from the lowest dip of a scan of `PLAUSIBLE`.
    """
    start = jax.vmap(_lowest_dip, 1)(_profile(batch))
    log_k, converged = jax.vmap(lambda x, log: _solve(_scaled, x, log))(start, batch)
    residual, tangent, curvature = jax.vmap(_statistics)(log_k, batch)
    return LagFit(log_k, residual, tangent, curvature, converged)


@jax.jit
def fit_pooled(batch: Batch) -> LagFit:
    """One k for all logs: the least mean of the logs' mean squares, so that all weigh the same."""
    start = _lowest_dip(jnp.mean(_profile(batch), axis=1))
    log_k, converged = _solve(jax.vmap(_scaled, (None, 0)), start, batch)
    residual, tangent, curvature = jax.vmap(_statistics, (None, 0))(log_k, batch)
    return LagFit(log_k, residual, tangent, curvature, converged)


@jax.jit
def residuals_at(k, batch: Batch) -> Float[Array, "logs samples"]:
    """Measured minus free run [psi] of every log at a given k [s]."""
    return jax.vmap(lambda log: residual_psi(jnp.log(k), log))(batch)
