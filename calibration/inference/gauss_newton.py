"""Least squares of the extended model to measured trials, over any of its parameters.

Each outer iteration simulates the trials, takes forward tangents along the free parameters, and
hands the small matrices to optimistix's Levenberg-Marquardt, which finds the best vector of the
linearised model within the bounds; a step that makes the sum of squares worse is halved.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from calibration.inference.bounds import Bounds
from calibration.inference.noise import Whitener
from calibration.inference.problem import AbstractProblem, ChannelBlock, summed, total
from calibration.model.extended import Parameter

ITERATIONS = 24
"""Outer iterations at most; most fits take 3 to 6, those of another law more."""
STILL = 0.02
"""A fit ends where the next step would lower the sum of squares by less than so many times the
residual's mean square: it lies within a seventh of a standard error."""
FAR, ROUGH = 20.0, 0.5
"""Of a model that leaves more than `FAR` times its noise's variance something is missing, and it is
fitted to within `ROUGH` of the mean square, two thirds of a standard error: it converges slowly,
and what is found missing is fitted with it again."""


class Fit(NamedTuple):
    """The outcome, at `theta`, with `free` (k,) its indices that were fitted."""

    theta: np.ndarray
    free: np.ndarray
    square: float
    """Sum of squares of the white residuals."""
    samples: int
    blocks: list[ChannelBlock]
    """Linearised at `theta`, along the `free` entries only."""
    predicted: list[np.ndarray]
    converged: bool
    apart: np.ndarray | None = None
    """By how much what varies of the forces asks for other values (k,), where beyond chance."""
    widening: np.ndarray | float = 1.0
    """Factor (k,) on the standard errors, which the two halves' difference asks for."""

    @property
    def inflation(self) -> float:
        """Mean square of the white residuals: 1 where the noise is as declared, at least 1."""
        return max(1.0, self.square / max(self.samples - len(self.free), 1))

    @property
    def covariance(self) -> np.ndarray:
        """Of the free entries (k, k), by the least squares' normal matrix and `inflation`."""
        A, _ = summed(self.blocks)
        return self.inflation * inverse(A) if np.isfinite(A).all() else np.full(A.shape, np.inf)

    @property
    def errors(self) -> np.ndarray:
        """Standard errors of the free entries (k,), widened."""
        return np.sqrt(np.diag(self.covariance)) * self.widening


def inverse(A: np.ndarray) -> np.ndarray:
    """Inverse of a normal matrix after scaling to a unit diagonal.

    A direction that the data do not see gets a variance of 1e12 times its scale.
    """
    size = np.sqrt(np.where(np.diag(A) > 0.0, np.diag(A), 1.0))
    values, vectors = np.linalg.eigh(A / np.outer(size, size))
    return (vectors / np.maximum(values, 1e-12)) @ vectors.T / np.outer(size, size)


def fit_gauss_newton(
    problem: AbstractProblem,
    entries: Sequence[Parameter],
    theta: np.ndarray,
    free: np.ndarray,
    progress: Callable[[str], None] = lambda text: None,
    white: dict[tuple[int, str], Whitener] | None = None,
) -> Fit:
    """Fit the entries `free` (indices) of the vector, from `theta` on; the others stay.

    A step that cannot be simulated is shortened; from a start that cannot be, or without finite
    tangents, the fit has not converged.
    Sums of squares of two fits compare only if they share `white`, by default that of the start.
    """
    bounds = Bounds.of([entries[i] for i in free])
    directions = np.eye(len(theta))[free]
    predicted = problem.predict(theta)
    white = problem.whiteners(predicted) if white is None else white
    residuals = problem.residuals(predicted, white)
    square, converged = total(residuals), False
    samples = sum(len(r) for r in residuals.values())
    for iteration in range(ITERATIONS):
        blocks = problem.blocks(residuals, problem.tangents(theta, directions), white)
        A, b = summed(blocks)
        if not (np.isfinite(A).all() and np.isfinite(b).all()):
            break
        wanted = _linear_optimum(A, b, theta[free], bounds)
        unit = max(1.0, square / max(samples, 1))
        step = wanted - theta[free]
        enough = unit * (STILL if unit < FAR else ROUGH)
        progress(f"iteration {iteration + 1}: sum of squares {square:.6g}")
        if 0.0 <= 2.0 * step @ b - step @ A @ step < enough:
            converged = True
            break
        for share in (1.0, 0.5, 0.25, 0.1, 0.03):
            trial = theta.copy()
            trial[free] = theta[free] + share * step
            tried = problem.predict(trial)
            found = problem.residuals(tried, white)
            if total(found) < square:
                break
        else:
            error = np.sqrt(unit * np.diag(inverse(A)))
            converged = bool(np.all(np.abs(step) < error))
            break
        gained = square - total(found)
        theta, predicted, residuals, square = trial, tried, found, total(found)
        if share == 1.0 and gained < enough:
            converged = True
            blocks = problem.blocks(residuals, problem.tangents(theta, directions), white)
            break
    return Fit(theta, np.asarray(free), square, samples, blocks, predicted, converged)


@jax.jit
def _solve(root, rhs, start, bounds):
    def residual(z, args):
        root, rhs, start = args
        return root @ (bounds.inside(z) - start) - rhs

    solution = optx.least_squares(
        residual,
        optx.LevenbergMarquardt(rtol=1e-9, atol=1e-9),
        bounds.outside(start),
        args=(root, rhs, start),
        max_steps=200,
        throw=False,
    )
    return bounds.inside(solution.value)


def _linear_optimum(A, b, start, bounds: Bounds) -> np.ndarray:
    """The vector within the bounds that minimises (x - start) A (x - start) - 2 b (x - start)."""
    size = np.sqrt(np.where(np.diag(A) > 0.0, np.diag(A), 1.0))
    values, vectors = np.linalg.eigh(A / np.outer(size, size))
    kept = np.maximum(values, 1e-12 * values.max())
    root = np.sqrt(kept)[:, None] * vectors.T * size
    rhs = (vectors.T @ (b / size)) / np.sqrt(kept)
    return np.asarray(_solve(jnp.asarray(root), jnp.asarray(rhs), jnp.asarray(start), bounds))
