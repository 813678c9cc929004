"""Other methods that identify missing effects, on the same data as the loop.

All methods start from the same calibrated model, and from the same residuals and tangents. These
are whitened by the declared noise.

- sparse: the lasso on the tangents of all effects (scikit-learn). Cross-validation over trials with
  the one-standard-error rule selects the penalty. The largest effects, at most eight, are refitted.
- stepwise: repeatedly adds the effect with the largest linear gain and refits. The method stops
  after four effects, or when the Bayesian information criterion no longer decreases. Every sample
  counts.
- knockoffs: the fixed-X knockoff filter on the tangents of all effects. The named effects, at most
  eight, are refitted.
- gp, sindy, network: regressions of the residual of each channel, with a Gaussian process, a sparse
  polynomial or a multilayer perceptron (scikit-learn). The inputs are the model's readings, their
  rates, the time in the stride and the trial's settings. These methods predict readings, but do not
  name effects.
- oracle: refits the model with the true effects.

`any_distortion_p` tests whether the calibrated model lacks anything at all.
"""

import warnings
import zlib
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.linear_model import lars_path_gram, lasso_path
from sklearn.neural_network import MLPRegressor
from sklearn.preprocessing import PolynomialFeatures, StandardScaler

from calibration.discrepancy.refits import effect_tangents
from calibration.discrepancy.rounds import effect_entries, scoring_entries
from calibration.discrepancy.scores import least_squares_step, square_after, square_reduction
from calibration.discrepancy.settings import DEFAULT_SETTINGS
from calibration.inference.gauss_newton import Fit, fit_gauss_newton, inverse
from calibration.inference.noise import Whitener
from calibration.inference.problem import FAILED, AbstractProblem, ChannelBlock, summed, total
from calibration.model.extended import Parameter
from slider_jax.channels import SLIDER_CHANNELS

PENALTIES = 60
"""Number of penalties of the lasso."""
GP_SAMPLES = 500
"""Number of readings to which a Gaussian process is fitted: the time grows with its cube."""
MAX_EFFECTS, MAX_REFITTED = 4, 8
"""Largest number of effects that `stepwise` names, and that the other methods refit."""
KNOCKOFF_FDR = 0.1
"""Target of the knockoff filter's modified false discovery rate, as in the paper."""
MAX_COSINE = 0.99
"""Of effects with a larger |cos| between their tangents, only the first is a candidate of the
knockoff filter. In six trials, four pairs of parameters had the cosine 1, and two had 0.998 and
0.993."""
LEAST_NORM = 1e-3
"""A column is omitted if the base parameters reduce its norm to less than this fraction."""
LEAST_DISTANCE = 1e-6
"""A column whose knockoff differs by a smaller s is never selected: the two are equal up to
rounding errors."""
BARRIERS = 0.5 ** np.arange(1.0, 21.0, 0.5)
"""Weights of the logarithmic barrier in the semidefinite program of the knockoffs."""
THRESHOLDS = (np.inf, *np.geomspace(1.0, 1e-3, 20))
"""Thresholds of `sindy`, in standard deviations of the residual. The first removes all terms."""
MAX_THRESHOLDINGS = 10
"""Largest number of iterations of `stlsq`, as in the paper."""
HIDDEN = 32
"""Number of hidden neurons of `network`."""


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
    """The calibrated base model."""
    blocks: list[ChannelBlock]
    """Normal equations of all parameters at `base`."""
    white: dict[tuple[int, str], Whitener]
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


def any_distortion_p(s: MethodInput) -> float:
    """Returns the p-value of the hypothesis that the base model lacks nothing.

    The statistic is the sum of squares of the whitened residual over all trials and channels, after
    the linear step of the fitted parameters. The step matters if the fit used other whiteners or
    ended before its optimum. Under the hypothesis, the statistic has the chi-squared distribution
    with n - k degrees of freedom, for n readings and k fitted parameters. The p-value is that of a
    larger statistic, because a missing effect adds to the sum.

    Tare, gain and initial swing cost no degree of freedom. They are not fitted: the whitener knows
    them as random with declared standard deviations, and whitens with the covariance of all noise
    together. Each of the n whitened readings therefore has unit variance.

    The test relies on the sizes of the noise: with n = 10,000, an error of 1 % of the standard
    deviation shifts the statistic by 1.4 of its standard deviations. The loop's discrepancies are
    measured values plus one standard error, so the p-value tends to be too large. Declared noise
    that is too small makes the p-value small, as a missing effect does. If the loop weighs
    heavy-tailed noise, the mean square of the weighed residual is below 1, and the p-value is near
    1.
    """
    A, b = summed(s.blocks)
    square = square_after(s.blocks, least_squares_step(A, b, s.base.free))
    return float(chi2.sf(square, sum(x.n for x in s.blocks) - len(s.base.free)))


def refitted(s: MethodInput, names: Sequence[str]) -> Fit:
    """Returns the fit of the model with the effects `names`.

    The fit starts from the linear step, or from the effects' own start values. A start that cannot
    be simulated is moved halfway to the base model.
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
    for _ in range(DEFAULT_SETTINGS.max_halvings):
        if total(s.problem.residuals(s.problem.predict(theta), s.white)) < FAILED:
            break
        theta[free] = 0.5 * (theta + s.base.theta)[free]
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


def knockoffs(s: MethodInput) -> MethodResult:
    """Returns the result of the fixed-X knockoff filter on the tangents of all effects.

    The columns are the whitened tangents, with the base parameters projected out and scaled to unit
    norm. The statistic of a column is the lasso-signed-max; that of an effect with several
    parameters is the statistic with the largest absolute value. Its sign is still a fair coin if
    the effect is absent.

    Knockoff+ with a target of 0.1 selects either nothing or at least ten effects, so it cannot name
    one or two missing effects. This method therefore uses the paper's knockoff threshold without
    the offset. It controls the modified false discovery rate E[V/(R + 10)], for V false ones among
    R named effects. It does not control the probability of a false name: with few missing effects,
    it stops at the first effect with a negative statistic, so that about one absent effect is named
    on average, and half of all complete models get a name.

    The tangents of some effects are collinear or nearly so. Equicorrelated knockoffs would then
    equal the columns and have no power. The method uses the paper's knockoffs by semidefinite
    programming, and only the first of effects with (nearly) equal tangents. As in all fixed-X
    filters, the columns must be exact: the error of the linearisation at a large effect can look
    like further effects.

    Source: Barber, R. F. and Candes, E. J. (2015), Controlling the false discovery rate via
    knockoffs, Ann. Stat. 43, 2055-2085.
    """
    columns = np.concatenate([*scoring_entries(s.entries).values()])
    (A, b), free = summed(s.blocks), s.base.free
    size = np.sqrt(np.maximum(np.diag(A), 1e-300))
    index = np.concatenate([free, columns])
    samples = sum(x.n for x in s.blocks)
    square = square_after(s.blocks, least_squares_step(A, b, index))
    M, v = _projected(A, b, free, columns, size)
    norm = np.sqrt(np.maximum(np.diag(M), 1e-300))
    M, v = M / np.outer(norm, norm), v / norm
    kept: list[int] = []
    for j in np.flatnonzero(norm > LEAST_NORM):
        if np.all(np.abs(M[j, kept]) < MAX_COSINE):
            kept.append(int(j))
    # The data of a tank are the seed, so that the draws of different tanks are independent.
    rng = np.random.default_rng(zlib.crc32(s.problem.records[0].values.tobytes()))
    W = knockoff_statistics(M[np.ix_(kept, kept)], v[kept], square / (samples - len(index)), rng)
    best: dict[str, float] = {}
    for i, w in zip(columns[kept], W, strict=True):
        name = s.entries[i].effect
        best[name] = max(best.get(name, 0.0), float(w), key=abs)
    threshold = knockoff_threshold(np.array([*best.values()]), KNOCKOFF_FDR)
    names = sorted((n for n in best if best[n] >= threshold), key=lambda n: -best[n])
    theta = refitted(s, names[:MAX_REFITTED]).theta if names else s.base.theta
    return MethodResult(names, s.rest.predict(theta))


def knockoff_statistics(
    M: np.ndarray, v: np.ndarray, variance: float, rng: np.random.Generator
) -> np.ndarray:
    """Returns the lasso-signed-max statistic W (p,) of each column of X.

    M = X^T X (p, p) has a unit diagonal, v = X^T y, and `variance` is the variance of the noise.
    The knockoffs are

        X~ = X (I - M^-1 S) + U C,    C^T C = 2 S - S M^-1 S,    S = diag(s)

    with orthonormal U (n, p) that is orthogonal to X. Only X~^T y is needed. U^T y contains noise
    only, so this part is drawn: N(0, `variance`) in each of its p entries. W = max(Z, Z~)
    sign(Z - Z~), with the penalties Z and Z~ at which a column and its knockoff enter the lasso.
    """
    s, p = knockoff_distances(M), len(v)
    shrink = s[:, None] * inverse(M)
    values, vectors = np.linalg.eigh(2.0 * np.diag(s) - shrink * s)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    copy = v - shrink @ v + np.sqrt(variance) * root @ rng.normal(size=p)
    cross = M - np.diag(s)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # at the end of the path
        penalties, _, x = lars_path_gram(
            np.concatenate([v, copy]), np.block([[M, cross], [cross, M]]), n_samples=1,
            max_iter=4 * p, method="lasso",
        )  # fmt: skip
    entered = x != 0.0
    Z = np.where(entered.any(axis=1), penalties[np.maximum(entered.argmax(axis=1) - 1, 0)], 0.0)
    W = np.maximum(Z[:p], Z[p:]) * np.sign(Z[:p] - Z[p:])
    return np.where(s > LEAST_DISTANCE, W, 0.0)


def knockoff_distances(M: np.ndarray) -> np.ndarray:
    """Returns the s (p,) of largest sum with 0 <= s <= 1 and positive semidefinite 2 M - diag(s).

    M (p, p) has a unit diagonal. Coordinate ascent maximises the sum of s plus a decreasing weight
    times log det(2 M - diag(s)). Source: Askari, A., Rebjock, Q., d'Aspremont, A. and El Ghaoui, L.
    (2021), FANOK: Knockoffs in linear time, SIAM J. Math. Data Sci. 3, 833-853.
    """
    s = np.zeros(len(M))
    for weight in BARRIERS:
        P = inverse(2.0 * M - np.diag(s))
        for j in range(len(s)):
            change = np.clip(s[j] + 1.0 / P[j, j] - weight, 0.0, 1.0) - s[j]
            s[j] += change
            P += change / (1.0 - change * P[j, j]) * np.outer(P[j], P[j])
    return s


def knockoff_threshold(W: np.ndarray, fdr: float, offset: int = 0) -> float:
    """Returns the smallest t > 0 with (offset + #{W <= -t}) <= fdr #{W >= t}; inf if there is none.

    The `offset` 1 is that of knockoff+.
    """
    for t in np.unique(np.abs(W[W != 0.0])):
        if offset + np.sum(W <= -t) <= fdr * np.sum(W >= t):
            return float(t)
    return float("inf")


def _features(problem: AbstractProblem, predicted: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Returns the inputs (samples, 12) of the regressions for every trial.

    The inputs are the model's readings, their rates, the time in the stride and the settings. A
    trial without a drive frequency has the frequency 0.
    """
    rows = [SLIDER_CHANNELS.row(c) for c in ("p_front", "recoil", "tip")]
    features = []
    for r, y in zip(problem.records, predicted, strict=True):
        frequency = r.trial.frequency or 0.0
        phase = 2.0 * np.pi * frequency * r.t
        rates = np.gradient(y[rows], r.t, axis=1)
        own = [np.full(len(r.t), x) for x in (frequency, r.trial.tow_speed)]
        features.append(np.stack([*y, *rates, np.sin(phase), np.cos(phase), *own], axis=1))
    return features


Prediction = Callable[[np.ndarray], np.ndarray]
"""Returns predicted residuals (n,) for features (n, k)."""


def _with_residual_model(
    s: MethodInput, fit: Callable[[np.ndarray, np.ndarray, np.ndarray], Prediction]
) -> MethodResult:
    """Returns the base model's prediction plus the prediction of each channel's residual.

    `fit` gets the standardised features (n, k) and the residual (n,) of one channel at all its
    readings, and the trial's index (n,). The residual is divided by its standard deviation.
    """
    seen = _features(s.problem, s.base.predicted)
    found = s.rest.predict(s.base.theta)
    scaler = StandardScaler().fit(np.concatenate(seen))
    seen = [scaler.transform(x) for x in seen]
    asked = [scaler.transform(x) for x in _features(s.rest, found)]
    predicted = [y.copy() for y in found]
    for channel in s.problem.channels:
        row, X, y, trials = SLIDER_CHANNELS.row(channel), [], [], []
        for i, (r, x) in enumerate(zip(s.problem.records, seen, strict=True)):
            there = r.there(channel)
            X.append(x[there])
            y.append((r.values[row] - s.base.predicted[i][row])[there])
            trials.append(np.full(len(y[-1]), i))
        residual = np.concatenate(y)
        size = max(float(np.std(residual)), 1e-300)
        with warnings.catch_warnings():
            # A kernel's scale without influence, or a slow last step of the network, is no fault.
            warnings.simplefilter("ignore", ConvergenceWarning)
            predict = fit(np.concatenate(X), residual / size, np.concatenate(trials))
        for z, x in zip(predicted, asked, strict=True):
            z[row] += size * predict(x)
    return MethodResult([], predicted)


def gp(s: MethodInput) -> MethodResult:
    """Returns the result of a Gaussian process for the residual of every channel.

    Source: Kennedy, M. C. and O'Hagan, A. (2001), Bayesian calibration of computer models, J. R.
    Stat. Soc. B 63, 425-464.
    """
    rng = np.random.default_rng(0)

    def fit(X: np.ndarray, y: np.ndarray, trials: np.ndarray) -> Prediction:
        pick = rng.permutation(len(y))[:GP_SAMPLES]
        kernel = ConstantKernel(1.0) * RBF(np.full(X.shape[1], 3.0), (0.1, 1e3))
        kernel += WhiteKernel(0.5, (1e-4, 1e2))
        return (
            GaussianProcessRegressor(kernel, n_restarts_optimizer=0).fit(X[pick], y[pick]).predict
        )

    return _with_residual_model(s, fit)


def sindy(s: MethodInput) -> MethodResult:
    """Returns the result of sequentially thresholded least squares for every channel's residual.

    The library contains all monomials of the features up to degree 2, and sign(x) and |x| x of each
    feature x, scaled to unit rms. The threshold has the smallest squared error in cross-validation
    over trials. Source: Brunton, S. L., Proctor, J. L. and Kutz, J. N. (2016), Discovering
    governing equations from data by sparse identification of nonlinear dynamical systems, PNAS 113,
    3932-3937. Their library describes the time derivative of a measured state. Most of the robot's
    state is not measured, so here the library describes the residual of the readings.
    """

    def library(X: np.ndarray) -> np.ndarray:
        return np.hstack([PolynomialFeatures(2).fit_transform(X), np.sign(X), np.abs(X) * X])

    def fit(X: np.ndarray, y: np.ndarray, trials: np.ndarray) -> Prediction:
        terms = library(X)
        size = np.sqrt(np.mean(terms**2, axis=0))
        size[size < 1e-12] = 1.0
        terms /= size
        own = [(terms[trials == i], y[trials == i]) for i in np.unique(trials)]
        A, b = np.array([T.T @ T for T, _ in own]), np.array([T.T @ z for T, z in own])

        def error(threshold: float) -> float:
            found = 0.0
            for A_, b_ in zip(A, b, strict=True):
                x = stlsq(A.sum(axis=0) - A_, b.sum(axis=0) - b_, threshold)
                found += float(x @ A_ @ x - 2.0 * b_ @ x)
            return found

        x = stlsq(A.sum(axis=0), b.sum(axis=0), min(THRESHOLDS, key=error))
        return lambda X: library(X) / size @ x

    return _with_residual_model(s, fit)


def stlsq(A: np.ndarray, b: np.ndarray, threshold: float) -> np.ndarray:
    """Returns the sparse solution x of A x = b by sequentially thresholded least squares.

    A least-squares solution and the removal of all terms with |x| below `threshold` alternate until
    no more terms are removed. The solution of collinear terms is that of least norm.
    """
    kept = np.ones(len(b), bool)
    for _ in range(MAX_THRESHOLDINGS):
        x = np.zeros(len(b))
        x[kept] = np.linalg.pinv(A[np.ix_(kept, kept)], rcond=1e-10, hermitian=True) @ b[kept]
        small = kept & (np.abs(x) < threshold)
        if not small.any():
            break
        kept = kept & ~small
    return x


def network(s: MethodInput) -> MethodResult:
    """Returns the result of a multilayer perceptron for the residual of every channel.

    The training ends early if the error in a random tenth of the readings no longer decreases.
    Source: Rumelhart, D. E., Hinton, G. E. and Williams, R. J. (1986), Learning representations by
    back-propagating errors, Nature 323, 533-536.
    """

    def fit(X: np.ndarray, y: np.ndarray, trials: np.ndarray) -> Prediction:
        model = MLPRegressor(
            hidden_layer_sizes=(HIDDEN,), early_stopping=True, max_iter=1000, random_state=0
        )
        return model.fit(X, y).predict

    return _with_residual_model(s, fit)


METHODS: dict[str, Callable[[MethodInput], MethodResult]] = {
    "sparse": sparse,
    "stepwise": stepwise,
    "knockoffs": knockoffs,
    "gp": gp,
    "sindy": sindy,
    "network": network,
}
"""Methods that run on every compared tank. `oracle` also needs the true effects."""
