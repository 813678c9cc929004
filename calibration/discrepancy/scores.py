"""Scores candidate effects with one linearisation of the model.

Let r be the whitened residual after the fit of the free parameters, J the whitened tangents of the
free parameters, and G the whitened tangents of a candidate. Trials and channels are stacked. P is
the projection onto the columns of J. The score uses the part G1 of G that is orthogonal to J:

    G1 = G - P G,    A = G1^T G1,    b = G1^T r,    gain = b^T A^-1 b

The gain is the reduction of the sum of squares if candidate and free parameters are fitted
together. Cross-validation fits candidate and free parameters to all trials except one, and
evaluates the gain in this held-out trial.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from calibration.discrepancy.settings import DEFAULT_SETTINGS, SelectionSettings
from calibration.inference.gauss_newton import inverse, marginal_information
from calibration.inference.problem import ChannelBlock, summed


class Score(NamedTuple):
    """Predicted result of a joint, linearised fit of a candidate and the free parameters."""

    name: str
    gain: float
    """Reduction of the sum of squares, divided by the residual's mean square."""
    p: float
    """Probability that noise causes at least this gain, times the number of candidates, at most
    1."""
    step: np.ndarray
    """Change (parameters,) of all parameters in the linear fit, in SI units."""
    left_out: np.ndarray
    """Cross-validated log gain log(S0/S1) of each trial that the candidate changes visibly. S0 and
    S1 are the held-out trial's sums of squares without and with the candidate."""
    held_gains: np.ndarray
    """Cross-validated gain of each of these trials: S0 - S1, divided by the mean square."""


def least_squares_step(
    A: np.ndarray, b: np.ndarray, index: np.ndarray, penalty: np.ndarray | float = 0.0
) -> np.ndarray:
    """Returns the least-squares step of the parameters `index`; zero for all other parameters.

    `penalty` (k,) are the weights of the squared steps that are added to the sum of squares.
    """
    step = np.zeros(len(b))
    own = A[np.ix_(index, index)]
    own[np.diag_indices(len(index))] += penalty
    step[index] = inverse(own) @ b[index]
    return step


def square_reduction(blocks: Sequence[ChannelBlock], step: np.ndarray) -> float:
    """Returns the reduction of the sum of squares of `blocks` by a step."""
    return sum(2.0 * step @ x.b - step @ x.A @ step for x in blocks)


def square_after(blocks: Sequence[ChannelBlock], step: np.ndarray) -> float:
    """Returns the sum of squares of `blocks` after a step."""
    return max(sum(x.c for x in blocks) - square_reduction(blocks, step), 1e-300)


def score(
    name: str,
    group: np.ndarray,
    free: np.ndarray,
    blocks: Sequence[ChannelBlock],
    unit: float,
    many: int,
    settings: SelectionSettings = DEFAULT_SETTINGS,
    ridge: float = 0.0,
    earlier: Sequence[int] = (),
) -> Score:
    """Returns the score of the candidate with the parameters `group`.

    The parameters `group` and `free` are fitted together. `unit` is the residual's mean square and
    `many` the number of candidates. With a `ridge`, the fits penalise the squared steps of the
    parameters `group` and `earlier`, a part of `free`. The weight of a step is `ridge` times the
    parameter's information in all trials, with all other parameters `free` projected out. Source:
    ridge regression, Hoerl, A. E. and Kennard, R. W. (1970), Technometrics 12, 55-67.
    """
    parameters, fitted = len(blocks[0].b), np.concatenate([free, group])
    penalised = np.isin(fitted, [*earlier, *group])
    # A dictionary has 250 parameters, and a score needs only a few of their rows.
    blocks = [x._replace(A=x.A[np.ix_(fitted, fitted)], b=x.b[fitted]) for x in blocks]
    both = np.arange(len(fitted))
    free, group = both[: len(free)], both[len(free) :]
    A, b = summed(blocks)
    penalty = np.zeros(len(both))
    if ridge:
        information = marginal_information(A, both[penalised], both[~penalised])
        penalty[penalised] = ridge * np.diag(information)
    of_free = penalty[: len(free)]
    step = least_squares_step(A, b, both, penalty)
    before = least_squares_step(A, b, free, of_free)
    gain = (square_reduction(blocks, step) - square_reduction(blocks, before)) / unit
    seen = {x.trial: 0.0 for x in blocks}
    for x in blocks:
        seen[x.trial] += float(step[group] @ x.A[np.ix_(group, group)] @ step[group])
    left_out, held_gains = [], []
    least = min(settings.visible_share * max(seen.values()), settings.visible_gain * unit)
    for trial in sorted(i for i in seen if seen[i] >= least):
        others = [x for x in blocks if x.trial != trial]
        held = [x for x in blocks if x.trial == trial]
        A_, b_ = summed(others) if others else (A, b)
        with_it = least_squares_step(A_, b_, both, penalty)
        without = least_squares_step(A_, b_, free, of_free)
        S0, S1 = square_after(held, without), square_after(held, with_it)
        left_out.append(np.log(S0 / S1))
        held_gains.append((S0 - S1) / unit)
    p = min(1.0, many * float(chi2.sf(max(gain, 0.0), len(group))))
    whole = np.zeros(parameters)
    whole[fitted] = step
    return Score(name, float(gain), p, whole, np.asarray(left_out), np.asarray(held_gains))


def blocks_at_null(
    blocks: Sequence[ChannelBlock], group: np.ndarray, distance: np.ndarray
) -> list[ChannelBlock]:
    """Returns the normal equations with the parameters `group` at their nulls.

    `blocks` are the normal equations of a fit. `distance` are the fitted values of `group` minus
    the nulls. The tangents of the fit are kept.
    """
    found = []
    for x in blocks:
        along = x.A[:, group] @ distance
        c = x.c + 2.0 * distance @ x.b[group] + distance @ along[group]
        found.append(x._replace(b=x.b + along, c=float(c)))
    return found


def tangent_cosine(A: np.ndarray, first: np.ndarray, second: np.ndarray, free: np.ndarray) -> float:
    """Returns the largest |cos| between the tangents of the candidates `first` and `second`.

    The parameters `free` are projected out; `A` is the normal matrix. If the cosine is 1, the data
    cannot discriminate between the candidates.
    """
    A, n = marginal_information(A, np.concatenate([first, second]), free), len(first)

    def root(M):
        values, vectors = np.linalg.eigh(M)
        kept = values > 1e-10 * max(values.max(), 1e-300)
        return vectors[:, kept] / np.sqrt(values[kept])

    cross = root(A[:n, :n]).T @ A[:n, n:] @ root(A[n:, n:])
    return float(np.linalg.svd(cross, compute_uv=False)[0]) if cross.size else 0.0
