"""Least-squares fit of many parameters by L-BFGS.

The gradient of the sum of squares is -2 J r, with the whitened residual r and the tangents J of the
whitened readings. Optax's L-BFGS computes the direction of a step in the unbounded variables z of
`Bounds`, each scaled to unit curvature. A backtracking line search on the simulated sum of squares
gives the length of the step. Many effects have nearly parallel tangents, which make a Gauss-Newton
step long and inaccurate. L-BFGS avoids this, as it does not invert the normal matrix for its steps.
"""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
import optax

from calibration.inference.gauss_newton import Bounds, Fit, inverse
from calibration.inference.noise import Whitener
from calibration.inference.problem import AbstractProblem, ChannelBlock, summed, total
from calibration.model.extended import Parameter

MAX_GRADIENTS = 60
"""Largest number of gradients that a fit computes."""
MEMORY = 20
"""Number of past gradients that L-BFGS uses."""
PREDICTED_GAIN_TOLERANCE = 0.003
"""The fit ends if the predicted reduction of the sum of squares is less than this multiple of the
residual's mean square. All parameters are then within 0.06 standard errors of the optimum."""
MAX_SCALE_CHANGE = 2.0
"""L-BFGS restarts if the square root of a variable's curvature changes by more than this factor."""
ARMIJO_SHARE = 1e-4
"""Armijo's rule: a step must give at least this fraction of the linearly predicted reduction."""
STEP_SHARES = (1.0, 0.3, 0.1, 0.03, 0.01)
"""Fractions of a step that the line search tries, in this order."""
MAX_STEP = 2.0
"""Largest step of a variable z. From mid-range, it moves a parameter to 88 % of its range."""


def fit_lbfgs(
    problem: AbstractProblem,
    entries: Sequence[Parameter],
    theta: np.ndarray,
    free: np.ndarray,
    progress: Callable[[str], None] = lambda text: None,
    white: dict[tuple[int, str], Whitener] | None = None,
) -> Fit:
    """Fits the parameters with the indices `free`; see `fit_gauss_newton` for the arguments."""
    bounds = Bounds.of([entries[i] for i in free])
    directions = np.eye(len(theta))[free]
    predicted = problem.predict(theta)
    white = problem.whiteners(predicted) if white is None else white
    residuals = problem.residuals(predicted, white)
    square, converged = total(residuals), False
    optimiser = optax.scale_by_lbfgs(memory_size=MEMORY, scale_init_precond=False)
    z = np.asarray(bounds.z_of(jnp.asarray(theta[free])))
    scale, state = np.ones_like(z), None
    blocks: list[ChannelBlock] = []
    for iteration in range(MAX_GRADIENTS):
        blocks = problem.blocks(residuals, problem.tangents(theta, directions), white)
        A, b = summed(blocks)
        unit = max(1.0, square / max(sum(x.n for x in blocks), 1))
        stretch = _stretch(bounds, z)
        A_z, gradient = A * np.outer(stretch, stretch), -2.0 * b * stretch
        gain = 0.25 * float(gradient @ inverse(A_z) @ gradient)
        text = f"sum of squares {square:.6g}, predicted gain {gain:.3g}"
        progress(f"iteration {iteration + 1}: {text}")
        if gain < PREDICTED_GAIN_TOLERANCE * unit:
            converged = True
            break
        now = np.sqrt(np.maximum(2.0 * np.diag(A_z), 1e-12))
        change = np.abs(np.log(now / scale))
        fresh = state is None or bool(np.any(change > np.log(MAX_SCALE_CHANGE)))
        if fresh:
            scale, state = now, optimiser.init(jnp.asarray(z * now))
        with jax.numpy_dtype_promotion("standard"):  # optax mixes integer types
            updates, state = optimiser.update(
                jnp.asarray(gradient / scale), state, jnp.asarray(z * scale)
            )
        step = np.clip(-np.asarray(updates) / scale, -MAX_STEP, MAX_STEP)
        slope = float(gradient @ step)
        if slope >= 0.0:  # after clipping, the step may increase the sum of squares
            step = np.clip(-gradient / scale**2, -MAX_STEP, MAX_STEP)
            slope = float(gradient @ step)
        for share in STEP_SHARES:
            tried = theta.copy()
            tried[free] = np.asarray(bounds.theta_of(jnp.asarray(z + share * step)))
            y = problem.predict(tried)
            found = problem.residuals(y, white)
            if total(found) < square + ARMIJO_SHARE * share * slope:
                break
        else:
            if fresh:
                break
            state = None
            continue
        z, theta, predicted, residuals, square = z + share * step, tried, y, found, total(found)
    samples = sum(x.n for x in blocks)
    return Fit(theta, np.asarray(free), square, samples, blocks, predicted, converged)


def _stretch(bounds: Bounds, z: np.ndarray) -> np.ndarray:
    """Returns d(theta)/dz (parameters,)."""
    share = 1.0 / (1.0 + np.exp(-z))
    return np.asarray(bounds.high - bounds.low) * share * (1.0 - share)
