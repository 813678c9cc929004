"""Least squares of many parameters by L-BFGS, without inverting what the data hardly see.

The gradient of the sum of squares is -2 J r of the same forward tangents that
`calibration.inference.gauss_newton`
takes; optax's L-BFGS makes the direction, in the bounded variables scaled to unit curvature each,
and a backtracking line search on the simulated sum of squares the step. Nearly parallel tangents,
of which a library of effects is full, make Gauss and Newton's step long and wild; here the last few
gradients alone shape it.
"""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
import optax

from calibration.inference.bounds import Bounds
from calibration.inference.gauss_newton import Fit, inverse
from calibration.inference.noise import Whitener
from calibration.inference.problem import AbstractProblem, ChannelBlock, summed, total
from calibration.model.extended import Parameter

ITERATIONS = 60
"""Gradients at most."""
MEMORY = 20
"""Gradients that shape a direction."""
CLOSE = 0.003
"""The descent ends where the linearised model promises a smaller gain, in units of the residual's
mean square: every parameter is then within 0.06 standard errors of its optimum."""
STALE = 2.0
"""Factor by which a variable's curvature may change, as its root, before the memory is dropped."""
SUFFICIENT = 1e-4
"""Share of the gain promised by the slope that a step must bring."""
SHARES = (1.0, 0.3, 0.1, 0.03, 0.01)
"""Of a direction, tried in this order."""
LONGEST = 2.0
"""Of a step in each bounded variable: from 0.5 of a range to 0.88 of it."""


def fit_lbfgs(
    problem: AbstractProblem,
    entries: Sequence[Parameter],
    theta: np.ndarray,
    free: np.ndarray,
    progress: Callable[[str], None] = lambda text: None,
    white: dict[tuple[int, str], Whitener] | None = None,
) -> Fit:
    """Fit the entries `free` (indices) of the vector, from `theta` on, as `fit` does."""
    bounds = Bounds.of([entries[i] for i in free])
    directions = np.eye(len(theta))[free]
    predicted = problem.predict(theta)
    white = problem.whiteners(predicted) if white is None else white
    residuals = problem.residuals(predicted, white)
    square, converged = total(residuals), False
    optimiser = optax.scale_by_lbfgs(memory_size=MEMORY, scale_init_precond=False)
    z = np.asarray(bounds.outside(jnp.asarray(theta[free])))
    scale, state = np.ones_like(z), None
    blocks: list[ChannelBlock] = []
    for iteration in range(ITERATIONS):
        blocks = problem.blocks(residuals, problem.tangents(theta, directions), white)
        A, b = summed(blocks)
        unit = max(1.0, square / max(sum(x.n for x in blocks), 1))
        stretch = _stretch(bounds, z)
        A_z, gradient = A * np.outer(stretch, stretch), -2.0 * b * stretch
        promised = 0.25 * float(gradient @ inverse(A_z) @ gradient)
        progress(f"iteration {iteration + 1}: sum of squares {square:.6g}, to gain {promised:.3g}")
        if promised < CLOSE * unit:
            converged = True
            break
        now = np.sqrt(np.maximum(2.0 * np.diag(A_z), 1e-12))
        fresh = state is None or bool(np.any(np.abs(np.log(now / scale)) > np.log(STALE)))
        if fresh:
            scale, state = now, optimiser.init(jnp.asarray(z * now))
        with jax.numpy_dtype_promotion("standard"):  # optax mixes widths of integers
            updates, state = optimiser.update(
                jnp.asarray(gradient / scale), state, jnp.asarray(z * scale)
            )
        step = np.clip(-np.asarray(updates) / scale, -LONGEST, LONGEST)
        slope = float(gradient @ step)
        if slope >= 0.0:  # clipping turned it uphill
            step = np.clip(-gradient / scale**2, -LONGEST, LONGEST)
            slope = float(gradient @ step)
        for share in SHARES:
            tried = theta.copy()
            tried[free] = np.asarray(bounds.inside(jnp.asarray(z + share * step)))
            y = problem.predict(tried)
            found = problem.residuals(y, white)
            if total(found) < square + SUFFICIENT * share * slope:
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
    """d(theta)/dz."""
    share = 1.0 / (1.0 + np.exp(-z))
    return np.asarray(bounds.high - bounds.low) * share * (1.0 - share)
