"""Other methods that identify missing effects, on the same data as the loop.

All methods start from the same calibrated model, and from the same residuals and tangents. These
are whitened by the declared noise.

- sparse: the lasso on the tangents of all effects (scikit-learn). Cross-validation over trials with
  the one-standard-error rule selects the penalty. The largest effects, at most eight, are refitted.
- stepwise: repeatedly adds the effect with the largest linear gain and refits. The method stops
  after four effects, or when the Bayesian information criterion no longer decreases. Every sample
  counts.
- gp: a Gaussian process for the residual of each channel (scikit-learn). The inputs are the model's
  readings, the time in the stride and the trial's settings. The method predicts readings, but does
  not name effects.
- oracle: refits the model with the true effects.
"""

import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.linear_model import lasso_path
from sklearn.preprocessing import StandardScaler

from calibration.discrepancy.refits import effect_tangents
from calibration.discrepancy.rounds import effect_entries, scoring_entries
from calibration.discrepancy.scores import least_squares_step, square_reduction
from calibration.inference.gauss_newton import Fit, fit_gauss_newton, inverse
from calibration.inference.problem import AbstractProblem, summed
from calibration.model.extended import Parameter
from slider_jax.channels import CHANNELS

PENALTIES = 60
GP_SAMPLES = 500
MAX_EFFECTS, MAX_REFITTED = 4, 8


class MethodResult(NamedTuple):
    """The effects that a method names, and the method's prediction of the held-out trials."""

    effects: list[str]
    predicted: list[np.ndarray]


class MethodInput(NamedTuple):
    """The input of all methods."""

    problem: AbstractProblem
    rest: AbstractProblem
    """The held-out trials."""
    entries: Sequence[Parameter]
    base: Fit
    blocks: list
    white: dict
    tangents: list[np.ndarray]


def method_input(
    problem: AbstractProblem, rest: AbstractProblem, entries: Sequence[Parameter], base: Fit
) -> MethodInput:
    """Returns the calibrated model's residuals, and the tangents along all parameters."""
    white = problem.whiteners(base.predicted)
    tangents = effect_tangents(problem, entries, base.theta, base.free)
    residuals = problem.residuals(base.predicted, white)
    blocks = problem.blocks(residuals, tangents, white)
    return MethodInput(problem, rest, entries, base, blocks, white, tangents)


def refitted(s: MethodInput, names: Sequence[str]) -> Fit:
    """Returns the fit of the model with the effects `names`.

    The fit starts from the linear step, or from the effects' own start values.
    """
    groups, judged = effect_entries(s.entries), scoring_entries(s.entries)
    free = np.concatenate([s.base.free, *(groups[n] for n in names)]).astype(int)
    A, b = summed(s.blocks)
    score = np.concatenate([s.base.free, *(judged[n] for n in names)]).astype(int)
    step = least_squares_step(A, b, score)
    theta = s.base.theta.copy()
    for i in free:
        prior = s.entries[i].prior
        theta[i] = np.clip(theta[i] + step[i], prior.low, prior.high)
        if s.entries[i].effect and prior.start is not None:
            theta[i] = prior.start
        elif s.entries[i].effect and theta[i] == prior.null and not s.entries[i].is_shape:
            theta[i] += 0.02 * (prior.high - prior.low)
    return fit_gauss_newton(s.problem, s.entries, theta, free, white=s.white)


def oracle(s: MethodInput, truth: Sequence[str]) -> MethodResult:
    """Returns the result of the model with the true effects."""
    best = refitted(s, truth)
    return MethodResult(list(truth), s.rest.predict(best.theta))


def sparse(s: MethodInput) -> MethodResult:
    """Returns the result of the lasso over all effects' tangents."""
    columns = np.concatenate([*scoring_entries(s.entries).values()])
    free, trials = s.base.free, sorted({x.trial for x in s.blocks})
    A, b = summed(s.blocks)
    size = np.sqrt(np.maximum(np.diag(A), 1e-300))
    _, v = _projected(A, b, free, columns, size)
    penalties = np.geomspace(np.abs(v).max(), 1e-3 * np.abs(v).max(), PENALTIES)
    missed = []
    for trial in trials:
        rest = summed([x for x in s.blocks if x.trial != trial])
        A_, b_ = summed([x for x in s.blocks if x.trial == trial])
        steps = _path(*rest, free, columns, size, penalties)
        missed.append(np.einsum("ik,ij,jk->k", steps, A_, steps) - 2.0 * b_ @ steps)
    mean, error = np.mean(missed, axis=0), np.std(missed, axis=0, ddof=1) / np.sqrt(len(trials))
    best = int(np.argmin(mean))
    chosen = int(np.flatnonzero(mean <= mean[best] + error[best])[0])
    step = _path(A, b, free, columns, size, penalties)[:, chosen]
    kept: dict[str, float] = {}
    for i in columns[step[columns] != 0.0]:
        name = s.entries[i].effect
        kept[name] = kept.get(name, 0.0) + abs(step[i]) * size[i]
    names = sorted(kept, key=lambda n: -kept[n])
    theta = refitted(s, names[:MAX_REFITTED]).theta if names else s.base.theta
    return MethodResult(names, s.rest.predict(theta))


def _projected(A, b, free, columns, size) -> tuple[np.ndarray, np.ndarray]:
    """Returns normal matrix and vector of the columns at unit size, with `free` projected out."""
    cross = A[np.ix_(columns, free)] @ inverse(A[np.ix_(free, free)])
    M = A[np.ix_(columns, columns)] - cross @ A[np.ix_(free, columns)]
    v = b[columns] - cross @ b[free]
    return M / np.outer(size[columns], size[columns]), v / size[columns]


def _path(A, b, free, columns, size, penalties) -> np.ndarray:
    """Returns the lasso's steps (parameters, penalties); the entries in `free` have no penalty."""
    root, values = _as_rows(*_projected(A, b, free, columns, size))
    x = lasso_path(root, values, alphas=penalties / len(values), max_iter=20000)[1]
    steps = np.zeros((len(b), len(penalties)))
    steps[columns] = x / size[columns, None]
    left = b[free, None] - A[np.ix_(free, columns)] @ steps[columns]
    steps[free] = inverse(A[np.ix_(free, free)]) @ left
    return steps


def _as_rows(M: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns rows and values whose normal equations are M x = v."""
    values, vectors = np.linalg.eigh(M)
    kept = values > 1e-10 * values.max()
    root = np.sqrt(values[kept])
    return root[:, None] * vectors[:, kept].T, (vectors[:, kept].T @ v) / root


def stepwise(s: MethodInput) -> MethodResult:
    """Returns the result of adding effects while the Bayesian information criterion decreases."""
    names: list[str] = []
    judged = scoring_entries(s.entries)
    samples = sum(x.n for x in s.blocks)
    current, blocks = s.base, s.blocks

    def criterion(square: float, parameters: int) -> float:
        return samples * np.log(square / samples) + parameters * np.log(samples)

    while len(names) < MAX_EFFECTS:
        A, b = summed(blocks)
        gains = {}
        for name, group in judged.items():
            if name not in names:
                step = least_squares_step(A, b, np.concatenate([current.free, group]))
                gains[name] = square_reduction(blocks, step)
        name = max(gains, key=lambda n: gains[n])
        better = refitted(s, [*names, name])
        if criterion(better.square, len(better.free)) >= criterion(
            current.square, len(current.free)
        ):
            break
        names.append(name)
        current = better
        residuals = s.problem.residuals(current.predicted, s.white)
        tangents = effect_tangents(s.problem, s.entries, current.theta, current.free)
        blocks = s.problem.blocks(residuals, tangents, s.white)
    return MethodResult(names, s.rest.predict(current.theta))


def _features(problem: AbstractProblem, predicted: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Returns the inputs (samples, 12) of the Gaussian process for every trial.

    The inputs are the model's readings, their rates, the time in the stride and the settings.
    """
    features = []
    for r, y in zip(problem.records, predicted, strict=True):
        phase = 2.0 * np.pi * (r.trial.frequency or 0.0) * r.t
        rates = np.gradient(y[[0, 3, 4]], axis=1)
        own = [np.full(len(r.t), x) for x in (r.trial.frequency, r.trial.tow_speed)]
        features.append(np.stack([*y, *rates, np.sin(phase), np.cos(phase), *own], axis=1))
    return features


def gp(s: MethodInput) -> MethodResult:
    """Returns the result of a Gaussian process for the residual of every channel."""
    rng = np.random.default_rng(0)
    there = _features(s.problem, s.base.predicted)
    method_input = s.rest.predict(s.base.theta)
    asked = _features(s.rest, method_input)
    scaler = StandardScaler().fit(np.concatenate(there))
    predicted = [y.copy() for y in method_input]
    for row, channel in enumerate(CHANNELS):
        X, y = [], []
        for r, f, base in zip(s.problem.records, there, s.base.predicted, strict=True):
            here = r.there(channel)
            X.append(f[here])
            y.append((r.values[row] - base[row])[here])
        X, y = scaler.transform(np.concatenate(X)), np.concatenate(y)
        pick = rng.permutation(len(y))[:GP_SAMPLES]
        size = float(np.std(y))
        kernel = ConstantKernel(1.0) * RBF(np.full(X.shape[1], 3.0), (0.1, 1e3))
        kernel += WhiteKernel(0.5, (1e-4, 1e2))
        process = GaussianProcessRegressor(kernel, n_restarts_optimizer=0)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)  # if an input has no influence
            process.fit(X[pick], y[pick] / size)
        for z, f in zip(predicted, asked, strict=True):
            z[row] += size * process.predict(scaler.transform(f))
    return MethodResult([], predicted)
