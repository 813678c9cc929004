"""Least-squares fit of the extended model to measured trials by Gauss-Newton steps.

Each iteration simulates the readings of the trials. Optimistix's Levenberg-Marquardt then minimises
the linearised sum of squares within the bounds. A step that does not lower the sum of squares is
shortened. The derivatives (tangents) of the readings with respect to the free parameters take much
more time than the readings. A successful step therefore keeps the tangents and corrects them with
Broyden's formula. New tangents are computed after a bad step and at the end of the fit. If few
entries are free, finite differences of simulated readings replace the tangents.

Source: Broyden, C. G. (1965), A class of methods for solving nonlinear simultaneous equations,
Math. Comp. 19, 577-593.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from calibration.inference.noise import Whitener
from calibration.inference.problem import (
    AbstractProblem,
    ChannelBlock,
    normal_equations,
    summed,
    total,
)
from calibration.model.extended import Parameter

MAX_ITERATIONS = 40
"""Most fits need 4 to 8 iterations. Fits need more if an effect replaces a part of the model."""
KEPT_SHARE = 0.5
"""A step keeps the tangents if the sum of squares decreases by more than this fraction of the
predicted decrease."""
GAIN_TOLERANCE = 0.02
"""A fit ends if the next step would lower the sum of squares by less than this multiple of the
residual's mean square. The parameters are then within 1/7 standard error of the optimum."""
INEXACT_GAIN_TOLERANCE = 0.5
"""Replaces `GAIN_TOLERANCE` in fits that need not be exact. The parameters are then within 0.7
standard errors of the optimum. The tolerance is 2.5 % of the least gain for which the loop adds an
effect."""
FEW, DIFFERENCE = 3, 1e-4
"""Finite differences replace tangents if at most one in `FEW` entries is free. One call computes
all tangents together, so a few tangents take nearly as long as all tangents. A finite difference
changes a parameter by the fraction `DIFFERENCE` of its prior range."""
FRESH_DISTANCE = 0.3
"""A fit may end without new derivatives if the parameters have moved by fewer standard errors than
this number."""
SHARES = (1.0, 0.5, 0.25, 0.1, 0.03)
"""Fractions of a step that are tried in this order. Only the whole step is tried if the derivatives
are not new, or if the predicted gain is below `INEXACT_GAIN_TOLERANCE` times the residual's mean
square: the derivatives belong to a coarser mesh, and near the optimum no step reaches this gain."""
NEAR_GAIN, INEXACT_NEAR_GAIN, NEAR_SHARES = 1.0, 4.0, (1.0, 0.25)
"""`NEAR_SHARES` replaces `SHARES` if the predicted gain is below `NEAR_GAIN` times the residual's
mean square, and above the limit for whole steps. There, the errors of the derivatives can be larger
than the derivatives of the sum of squares, so that no step lowers it. `INEXACT_NEAR_GAIN` applies
to fits that need not be exact."""
STALLED = 3
"""A fit ends after this many successive steps whose gain is below the tolerance although the
predicted gain is above it. Without this limit, a fit of two nearly equal effects of the valves used
all iterations. One such step is enough if its derivatives are new and its predicted gain is below
`NEAR_GAIN` (or `INEXACT_NEAR_GAIN`): better steps need better derivatives."""
POOR_FIT = 20.0
"""If the residual's mean square exceeds this value, the model lacks an effect. Such a fit converges
slowly, and is repeated with the missing effect. Therefore it need not be exact."""


class Fit(NamedTuple):
    """A fitted parameter vector, the predicted readings, and the linearised normal equations."""

    theta: np.ndarray
    free: np.ndarray
    """Indices (k,) of the fitted entries of `theta`."""
    square: float
    """Sum of squares of the whitened residuals."""
    samples: int
    blocks: list[ChannelBlock]
    """Normal equations of each trial and channel for the `free` entries, linearised at `theta`."""
    predicted: list[np.ndarray]
    converged: bool
    difference: np.ndarray | None = None
    """Change (k,) of the fitted entries if the trials' mean forces are not used; 0 if the change is
    not significant. None before `uncertainty.hausman_check`."""
    widening: np.ndarray | float = 1.0
    """Factor (k,) that widens the standard errors of entries with a significant `difference`."""
    correlation: np.ndarray | float = 1.0
    """Factor (k,) that widens the standard errors if the whitened residuals are correlated."""
    discrepancy_products: np.ndarray | None = None
    """Products (channels, k) of a discrepancy that repeats in all trials and the derivatives of the
    whitened readings by the fitted entries. None before `uncertainty.shift_by_discrepancy`."""
    linearised_at: np.ndarray | None = None
    """Parameters near `theta` at which the fit computed the derivatives last, or None."""

    @property
    def inflation(self) -> float:
        """Returns the mean square of the whitened residuals, at least 1."""
        return max(1.0, self.square / max(self.samples - len(self.free), 1))

    @property
    def covariance(self) -> np.ndarray:
        """Returns the covariance (k, k) of the free entries, multiplied by `inflation`."""
        A, _ = summed(self.blocks)
        return self.inflation * inverse(A) if np.isfinite(A).all() else np.full(A.shape, np.inf)

    @property
    def widened_covariance(self) -> np.ndarray:
        """Returns the covariance (k, k) of the free entries, with wider standard errors.

        The errors are multiplied by the larger of `widening` and `correlation`. Both factors allow
        for errors that white noise does not explain.
        """
        factors = np.broadcast_to(np.maximum(self.widening, self.correlation), self.free.shape)
        return self.covariance * np.outer(factors, factors)

    @property
    def errors(self) -> np.ndarray:
        """Returns the standard errors (k,) of the free entries, from `widened_covariance`."""
        return np.sqrt(np.diag(self.widened_covariance))

    @property
    def shifts(self) -> np.ndarray:
        """Returns the changes (channels, k) of the free entries by a discrepancy of all trials.

        There are no rows before `uncertainty.shift_by_discrepancy`.
        """
        if self.discrepancy_products is None:
            return np.zeros((0, len(self.free)))
        return self.discrepancy_products @ inverse(summed(self.blocks)[0])

    def with_fixed(self, indices: Sequence[int]) -> "Fit":
        """Returns the fit with the entries `indices` fixed at their fitted values.

        `widening` and `correlation` remain those of the fit with all entries.
        """
        kept = ~np.isin(self.free, indices)
        blocks = [x._replace(A=x.A[np.ix_(kept, kept)], b=x.b[kept]) for x in self.blocks]
        products = self.discrepancy_products
        return self._replace(
            free=self.free[kept],
            blocks=blocks,
            difference=None,
            widening=np.broadcast_to(self.widening, kept.shape)[kept],
            correlation=np.broadcast_to(self.correlation, kept.shape)[kept],
            discrepancy_products=None if products is None else products[:, kept],
        )


class Bounds(NamedTuple):
    """Logistic transform of free variables z to theta = low + (high - low)/(1 + exp(-z))."""

    low: Float[Array, " parameters"]
    high: Float[Array, " parameters"]

    @classmethod
    def of(cls, entries: Sequence[Parameter]) -> "Bounds":
        """Returns the prior ranges as bounds.

        If a range ends at the effect's null, the bound is beyond the null by 5 % of the range. The
        fit can then reach the null, although a fitted value only approaches its bounds.
        """
        low, high = [], []
        for p in entries:
            slack = 0.05 * (p.prior.high - p.prior.low) if p.effect else 0.0
            low.append(p.prior.low - (slack if p.prior.null == p.prior.low else 0.0))
            high.append(p.prior.high + (slack if p.prior.null == p.prior.high else 0.0))
        return cls(jnp.asarray(low), jnp.asarray(high))

    def theta_of(self, z):
        """Returns theta (parameters,) of z (parameters,)."""
        return self.low + (self.high - self.low) / (1.0 + jnp.exp(-z))

    def share_of(self, theta):
        """Returns the position of theta in the range: 0 at the low bound, 1 at the high bound."""
        return (theta - self.low) / (self.high - self.low)

    def z_of(self, theta):
        """Returns z of theta. A theta at a bound is first moved inside by 1e-6 of the range."""
        share = jnp.clip(self.share_of(theta), 1e-6, 1.0 - 1e-6)
        return jnp.log(share / (1.0 - share))


def inverse(A: np.ndarray) -> np.ndarray:
    """Returns the inverse of a normal matrix, computed after scaling to a unit diagonal.

    The variance of the scaled variables is limited to 1e12 in directions without information.
    """
    size = np.sqrt(np.where(np.diag(A) > 0.0, np.diag(A), 1.0))
    values, vectors = np.linalg.eigh(A / np.outer(size, size))
    return (vectors / np.maximum(values, 1e-12)) @ vectors.T / np.outer(size, size)


def marginal_information(A: np.ndarray, group: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Returns the Fisher information on the entries `group` if the entries `free` are unknown."""
    cross = A[np.ix_(group, free)]
    return A[np.ix_(group, group)] - cross @ inverse(A[np.ix_(free, free)]) @ cross.T


def fit_gauss_newton(
    problem: AbstractProblem,
    entries: Sequence[Parameter],
    theta: np.ndarray,
    free: np.ndarray,
    progress: Callable[[str], None] = lambda text: None,
    white: dict[tuple[int, str], Whitener] | None = None,
    exact: bool = True,
    least_decrease: Callable[[float], float] = lambda square: 0.0,
    linearised_at: np.ndarray | None = None,
) -> Fit:
    """Returns the fit of the entries `free` (indices) of `theta`; the other entries are fixed.

    A step is shortened if the simulation fails. The fit does not converge if the simulation or a
    tangent at the start fails, or if steps gain much less than predicted and the next step is not
    shorter than one standard error. `white` are the
    whiteners of the residuals (default: computed from the readings at the start). Only fits with
    the same whiteners have comparable sums of squares. If `exact` is false, the fit ends
    earlier, and it may end with tangents from differences and Broyden's formula. The fit also ends
    if the predicted decrease of the sum of squares S is below `least_decrease(S)`. If the problem's
    cache contains derivatives at parameters `linearised_at` near `theta`, the fit starts with them.
    """
    bounds = Bounds.of([entries[i] for i in free])
    predicted = problem.predict(theta)
    white = problem.whiteners(predicted) if white is None else white
    residuals = problem.residuals(predicted, white)
    square, converged = total(residuals), False
    samples = sum(len(r) for r in residuals.values())
    J, fresh, origin, stalled, near_end = None, True, theta, 0, None
    for iteration in range(MAX_ITERATIONS):
        if J is None:
            at = theta if iteration or linearised_at is None else linearised_at
            J = problem.whitened(reading_derivatives(problem, entries, at, free), white)
            fresh, origin = bool(np.array_equal(at, theta)), at
        blocks = normal_equations(residuals, J)
        A, b = summed(blocks)
        if not (np.isfinite(A).all() and np.isfinite(b).all()):
            break
        unit = max(1.0, square / max(samples, 1))
        step = linear_optimum(A, b, theta[free], bounds) - theta[free]
        expected = 2.0 * step @ b - step @ A @ step
        least = GAIN_TOLERANCE if exact and unit < POOR_FIT else INEXACT_GAIN_TOLERANCE
        enough = max(unit * least, least_decrease(square))
        progress(f"iteration {iteration + 1}: sum of squares {square:.6g}")
        moved = (theta - origin)[free]
        recent = fresh or moved @ A @ moved < FRESH_DISTANCE**2 * unit
        if abs(expected) < enough:
            if recent or not exact:
                converged, near_end = True, origin
                break
            J = None
            continue
        near = expected < unit * (NEAR_GAIN if exact else INEXACT_NEAR_GAIN)
        at_end = expected < unit * INEXACT_GAIN_TOLERANCE
        shares = (NEAR_SHARES if near else SHARES) if fresh and not at_end else SHARES[:1]
        for share in shares if stalled < STALLED else ():
            trial = theta.copy()
            trial[free] = theta[free] + share * step
            tried = problem.predict(trial)
            found = problem.residuals(tried, white)
            if total(found) < square:
                break
        else:
            if (not fresh and stalled < STALLED and (exact or not near)) or (exact and not recent):
                J = None
                continue
            error = np.sqrt(unit * np.diag(inverse(A)))
            converged = bool(np.all(np.abs(step) < error))
            near_end = origin
            break
        gained = square - total(found)
        stalled = stalled + 1 if gained < enough else 0
        if share == 1.0 and enough < gained and KEPT_SHARE * expected < gained:
            change = {key: r - found[key] for key, r in residuals.items()}
            J, fresh = broyden_update(J, change, step, A), False
        elif gained < enough and near and fresh:
            stalled, fresh = STALLED, False
        else:
            J = None
        theta, predicted, residuals, square = trial, tried, found, total(found)
    else:
        J = problem.whitened(reading_derivatives(problem, entries, theta, free), white)
        blocks = normal_equations(residuals, J)
    fit = Fit(theta, np.asarray(free), square, samples, blocks, predicted, converged)
    return fit._replace(linearised_at=near_end)


def derivatives_of_fit(
    problem: AbstractProblem, entries: Sequence[Parameter], fit: Fit
) -> list[np.ndarray]:
    """Returns `reading_derivatives` at `linearised_at`, or at `theta` if that is None.

    The problem's cache contains the derivatives at `linearised_at`.
    """
    at = fit.theta if fit.linearised_at is None else fit.linearised_at
    return reading_derivatives(problem, entries, at, fit.free)


def reading_derivatives(
    problem: AbstractProblem, entries: Sequence[Parameter], theta: np.ndarray, free: np.ndarray
) -> list[np.ndarray]:
    """Returns each trial's derivatives (k, channels, samples) of the readings by `free` entries.

    The derivatives are finite differences if few entries are free and if all these differences are
    finite numbers. Otherwise, the derivatives are tangents.
    """
    unit = np.eye(len(theta))[free]
    if takes_differences(theta, free):
        steps = np.array([difference_step(entries[i], theta[i]) for i in free])
        changes = problem.secants(theta, list(theta + steps[:, None] * unit))
        rows = problem.all_channels.rows(problem.channels)
        if all(np.isfinite(x[:, rows]).all() for x in changes):
            return [x / steps[:, None, None] for x in changes]
    return problem.tangents(theta, unit)


def takes_differences(theta: np.ndarray, free: np.ndarray) -> bool:
    """Returns whether finite differences take less time than tangents along the `free` entries."""
    return len(theta) >= FEW * len(free)


def difference_step(p: Parameter, value: float) -> float:
    """Returns the change of a parameter for a finite difference; the change stays in the range."""
    step = DIFFERENCE * (p.prior.high - p.prior.low)
    return step if value + step < p.prior.high else -step


def broyden_update(
    J: dict[tuple[int, str], np.ndarray],
    change: dict[tuple[int, str], np.ndarray],
    step: np.ndarray,
    A: np.ndarray,
) -> dict[tuple[int, str], np.ndarray]:
    """Returns the derivatives J (k, n), corrected so that they predict `change` (n,) for `step`.

    The parameters are scaled by the diagonal of the normal matrix `A`. The result has the precision
    of `J`.
    """
    return broyden_correction(J, change, step, A).of(J)


class BroydenCorrection(NamedTuple):
    """A correction of derivatives J (k, n) by the outer product of two vectors."""

    weight: np.ndarray
    """Vector (k,)."""
    error: dict[tuple[int, str], np.ndarray]
    """Vector (n,) of each trial and channel."""

    def of(self, J: dict[tuple[int, str], np.ndarray]) -> dict[tuple[int, str], np.ndarray]:
        """Returns the corrected derivatives, with the precision of `J`."""
        return {
            key: (x + np.outer(self.weight, self.error[key])).astype(x.dtype, copy=False)
            for key, x in J.items()
        }


def broyden_correction(
    J: dict[tuple[int, str], np.ndarray],
    change: dict[tuple[int, str], np.ndarray],
    step: np.ndarray,
    A: np.ndarray,
) -> BroydenCorrection:
    """Returns the correction of `broyden_update`, with the precision of `J`."""
    scale = np.maximum(np.diag(A), 1e-300)
    weight = scale * step / (step @ (scale * step))
    error = {key: (change[key] - step @ x).astype(x.dtype) for key, x in J.items()}
    return BroydenCorrection(weight, error)


@jax.jit
def _solve(root, rhs, start, bounds):
    def residual(z, args):
        root, rhs, start = args
        return root @ (bounds.theta_of(z) - start) - rhs

    solution = optx.least_squares(
        residual,
        optx.LevenbergMarquardt(rtol=1e-9, atol=1e-9),
        bounds.z_of(start),
        args=(root, rhs, start),
        max_steps=200,
        throw=False,
    )
    return bounds.theta_of(solution.value)


def linear_optimum(A, b, start, bounds: Bounds) -> np.ndarray:
    """Returns the x within `bounds` that minimises d A d - 2 b d, with d = x - start."""
    size = np.sqrt(np.where(np.diag(A) > 0.0, np.diag(A), 1.0))
    values, vectors = np.linalg.eigh(A / np.outer(size, size))
    kept = np.maximum(values, 1e-12 * values.max())
    root = np.sqrt(kept)[:, None] * vectors.T * size
    rhs = (vectors.T @ (b / size)) / np.sqrt(kept)
    return np.asarray(_solve(jnp.asarray(root), jnp.asarray(rhs), jnp.asarray(start), bounds))
