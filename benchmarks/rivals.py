"""Other ways to say what a model lacks, on the data that the loop is given.

All start from the same calibrated model, residuals and tangents, whitened by the declared noise:

- sparse: the lasso over all effects' tangents, its penalty by cross-validation over trials with the
  one-standard-error rule (scikit-learn); the largest of what it keeps, eight at most, are refitted.
- stepwise: the effect with the largest linear gain is added and refitted while that lowers the
  Bayesian information criterion, samples counted one by one, four at most.
- gp: a Gaussian process on the residual of each channel over the model's readings, the time in the
  stride and the trial's settings (scikit-learn); it predicts and names nothing.
- oracle: the true effects, given; refitted.
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

from calibration.discrepancy.rounds import effect_entries, scoring_entries
from calibration.discrepancy.scores import least_squares_step, square_reduction
from calibration.discrepancy.selection import effect_tangents
from calibration.inference.gauss_newton import Fit, fit_gauss_newton, inverse
from calibration.inference.problem import AbstractProblem, summed
from calibration.model.extended import Parameter
from slider_jax.channels import CHANNELS

PENALTIES = 60
GP_SAMPLES = 500
MOST, REFITTED = 4, 8


class Said(NamedTuple):
    """What a way says: the effects, and its prediction of the trials that were held out."""

    effects: list[str]
    predicted: list[np.ndarray]


class Start(NamedTuple):
    """What all ways are given."""

    problem: AbstractProblem
    rest: AbstractProblem
    """The trials that were held out."""
    entries: Sequence[Parameter]
    base: Fit
    blocks: list
    white: dict
    everything: list[np.ndarray]


def begin(
    problem: AbstractProblem, rest: AbstractProblem, entries: Sequence[Parameter], base: Fit
) -> Start:
    """The calibrated model's residuals and tangents along everything."""
    white = problem.whiteners(base.predicted)
    everything = effect_tangents(problem, entries, base.theta, base.free)
    residuals = problem.residuals(base.predicted, white)
    blocks = problem.blocks(residuals, everything, white)
    return Start(problem, rest, entries, base, blocks, white, everything)


def refitted(s: Start, names: Sequence[str]) -> Fit:
    """The model with `names`, from where the linear step or their starts say."""
    members, judged = effect_entries(s.entries), scoring_entries(s.entries)
    free = np.concatenate([s.base.free, *(members[n] for n in names)]).astype(int)
    A, b = summed(s.blocks)
    score = np.concatenate([s.base.free, *(judged[n] for n in names)]).astype(int)
    step = least_squares_step(A, b, score)
    theta = s.base.theta.copy()
    for i in free:
        prior = s.entries[i].prior
        theta[i] = np.clip(theta[i] + step[i], prior.low, prior.high)
        if s.entries[i].effect and prior.start is not None:
            theta[i] = prior.start
        elif s.entries[i].effect and theta[i] == prior.null:
            theta[i] += 0.02 * (prior.high - prior.low)
    return fit_gauss_newton(s.problem, s.entries, theta, free, white=s.white)


def oracle(s: Start, truth: Sequence[str]) -> Said:
    """The true effects, given."""
    best = refitted(s, truth)
    return Said(list(truth), s.rest.predict(best.theta))


def sparse(s: Start) -> Said:
    """The lasso over all effects' tangents."""
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
    theta = refitted(s, names[:REFITTED]).theta if names else s.base.theta
    return Said(names, s.rest.predict(theta))


def _projected(A, b, free, columns, size) -> tuple[np.ndarray, np.ndarray]:
    """Normal matrix and vector of the columns at unit size, the free entries projected out."""
    cross = A[np.ix_(columns, free)] @ inverse(A[np.ix_(free, free)])
    M = A[np.ix_(columns, columns)] - cross @ A[np.ix_(free, columns)]
    v = b[columns] - cross @ b[free]
    return M / np.outer(size[columns], size[columns]), v / size[columns]


def _path(A, b, free, columns, size, penalties) -> np.ndarray:
    """Steps (parameters, penalties) of the lasso over the columns, the free entries unpenalised."""
    root, values = _as_rows(*_projected(A, b, free, columns, size))
    x = lasso_path(root, values, alphas=penalties / len(values), max_iter=20000)[1]
    steps = np.zeros((len(b), len(penalties)))
    steps[columns] = x / size[columns, None]
    left = b[free, None] - A[np.ix_(free, columns)] @ steps[columns]
    steps[free] = inverse(A[np.ix_(free, free)]) @ left
    return steps


def _as_rows(M: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and values whose normal equations are M x = v."""
    values, vectors = np.linalg.eigh(M)
    kept = values > 1e-10 * values.max()
    root = np.sqrt(values[kept])
    return root[:, None] * vectors[:, kept].T, (vectors[:, kept].T @ v) / root


def stepwise(s: Start) -> Said:
    """Effects added while the Bayesian information criterion falls."""
    names: list[str] = []
    judged = scoring_entries(s.entries)
    samples = sum(x.n for x in s.blocks)
    current, blocks = s.base, s.blocks

    def criterion(square: float, parameters: int) -> float:
        return samples * np.log(square / samples) + parameters * np.log(samples)

    while len(names) < MOST:
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
        everything = effect_tangents(s.problem, s.entries, current.theta, current.free)
        blocks = s.problem.blocks(residuals, everything, s.white)
    return Said(names, s.rest.predict(current.theta))


def _features(problem: AbstractProblem, predicted: Sequence[np.ndarray]) -> list[np.ndarray]:
    """(samples, 12) of every trial: model's readings and their rates, time in stride, settings."""
    found = []
    for r, y in zip(problem.records, predicted, strict=True):
        phase = 2.0 * np.pi * (r.trial.frequency or 0.0) * r.t
        rates = np.gradient(y[[0, 3, 4]], axis=1)
        own = [np.full(len(r.t), x) for x in (r.trial.frequency, r.trial.tow_speed)]
        found.append(np.stack([*y, *rates, np.sin(phase), np.cos(phase), *own], axis=1))
    return found


def gp(s: Start) -> Said:
    """A Gaussian process on what the calibrated model leaves of every channel."""
    rng = np.random.default_rng(0)
    there = _features(s.problem, s.base.predicted)
    begin = s.rest.predict(s.base.theta)
    asked = _features(s.rest, begin)
    scaler = StandardScaler().fit(np.concatenate(there))
    predicted = [y.copy() for y in begin]
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
            warnings.simplefilter("ignore", ConvergenceWarning)  # a feature without a say
            process.fit(X[pick], y[pick] / size)
        for z, f in zip(predicted, asked, strict=True):
            z[row] += size * process.predict(scaler.transform(f))
    return Said([], predicted)
