"""Refits of a model with one effect added, removed or substituted."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calibration.discrepancy.ranges import inside
from calibration.discrepancy.rounds import effect_entries, relative_changes, scoring_entries
from calibration.discrepancy.settings import DEFAULT_SETTINGS, SelectionSettings
from calibration.inference.gauss_newton import (
    SHARES,
    Bounds,
    BroydenCorrection,
    Fit,
    broyden_correction,
    derivatives_of_fit,
    fit_gauss_newton,
    inverse,
    linear_optimum,
    reading_derivatives,
)
from calibration.inference.measured_discrepancy import DiscrepancyMeter
from calibration.inference.noise import Whitener
from calibration.inference.problem import FAILED, AbstractProblem, normal_equations, summed, total
from calibration.model.extended import Parameter

MOST_KEPT = 2**29
"""Largest size of the tangents that are kept beside the whitened tangents [bytes]. A cache on the
disk contains larger tangents. With 150 parameters, six minutes of samples at 500 Hz have this
size."""


def effect_tangents(
    problem: AbstractProblem,
    entries: Sequence[Parameter],
    theta: np.ndarray,
    free: np.ndarray,
    settings: SelectionSettings = DEFAULT_SETTINGS,
) -> list[np.ndarray]:
    """Returns the readings' change per unit of each parameter, for each trial.

    Each array has the shape (parameters, channels, samples). For a parameter with a `Prior.start`,
    the array contains the secant from null to start. If a secant cannot be simulated, its step is
    halved. For free parameters and effects without a start, the array contains tangents at `theta`.
    For all other parameters, and where a tangent is not finite, the array is zero. The arrays have
    single precision: they are the largest arrays of the loop, and the mesh causes larger errors.
    """
    scored = np.unique(np.concatenate([free, *scoring_entries(entries).values()]))
    finite = [i for i in scored if entries[i].prior.start is not None and i not in free]
    tangential = [i for i in scored if i not in finite]
    directions = np.zeros((len(theta), len(theta)))
    directions[tangential, tangential] = 1.0
    found = [x.astype(np.float32, copy=False) for x in problem.tangents(theta, directions)]
    failed = _failed(found, problem)
    for x in found:
        x[failed] = 0.0
    _set_secants(found, finite, theta, problem, entries, settings)
    return found


def renewed_tangents(
    last: list[np.ndarray],
    problem: AbstractProblem,
    entries: Sequence[Parameter],
    current: Fit,
    near: Sequence[str],
    settings: SelectionSettings = DEFAULT_SETTINGS,
) -> list[np.ndarray]:
    """Returns `last`, the tangents at another fit, with new rows for the fit `current`.

    The new rows are those of the free parameters and of the effects `near`. They are finite
    differences, which take less time than tangents if they are few. `last` is changed.
    """
    groups, theta, free = scoring_entries(entries), current.theta, current.free
    own = [int(i) for name in near for i in groups[name] if i not in free]
    finite = [i for i in own if entries[i].prior.start is not None]
    rest = np.array([i for i in own if i not in finite], int)
    _set_rows(last, free, derivatives_of_fit(problem, entries, current), problem)
    if len(rest):
        _set_rows(last, rest, reading_derivatives(problem, entries, theta, rest), problem)
    _set_secants(last, finite, theta, problem, entries, settings)
    return last


def _set_rows(
    found: list[np.ndarray],
    rows: Sequence[int] | np.ndarray,
    along: list[np.ndarray],
    problem: AbstractProblem,
) -> None:
    """Sets `rows` of the arrays `found` to the derivatives `along`, or to zero if not finite."""
    failed = _failed(along, problem)
    for x, new in zip(found, along, strict=True):
        x[rows] = new
        x[np.asarray(rows)[failed]] = 0.0


def _failed(along: list[np.ndarray], problem: AbstractProblem) -> np.ndarray:
    """Returns for each row (k,) of the derivatives `along` whether a value is not finite."""
    channels = problem.all_channels.rows(problem.channels)
    finite = [np.isfinite(x[:, c]).all(axis=1) for x in along for c in channels]
    return ~np.all(finite, axis=0)


def _set_secants(
    found: list[np.ndarray],
    rows: Sequence[int],
    theta: np.ndarray,
    problem: AbstractProblem,
    entries: Sequence[Parameter],
    settings: SelectionSettings,
) -> None:
    """Sets `rows` of the arrays `found` to secants from the null to the start of a parameter."""
    channels, unit = problem.all_channels.rows(problem.channels), np.eye(len(theta))
    priors = {i: entries[i].prior for i in rows}
    size = {i: p.start - p.null for i, p in priors.items() if p.start is not None}
    for _ in range(settings.max_halvings):
        if not size:
            break
        order = list(size)
        changes = problem.secants(theta, [theta + size[i] * unit[i] for i in order])
        for row, i in enumerate(order):
            if all(np.isfinite(c[row][channels]).all() for c in changes):
                for x, c in zip(found, changes, strict=True):
                    x[i] = c[row] / size[i]
                del size[i]
            else:
                size[i] *= 0.5


def initial_theta(
    refits: "Refits", theta: np.ndarray, group: np.ndarray, step: np.ndarray
) -> np.ndarray:
    """Returns the parameter vector from which a refit with an additional effect starts.

    `group` are the indices of the effect's parameters. Parameters with a `Prior.start` start there.
    If no parameter has a start, the vector is `theta` plus the `step` of the effect's score. Shape
    parameters do not move.
    """
    entries = refits.entries
    starts = [i for i in group if entries[i].prior.start is not None]
    if starts:
        theta = theta.copy()
        theta[starts] = [entries[i].prior.start for i in starts]
        return theta
    low, high = np.array([[p.prior.low, p.prior.high] for p in entries]).T
    moved = np.where(step == 0.0, theta, np.clip(theta + step, low, high))
    strengths = np.array([i for i in group if not entries[i].is_shape])
    still = strengths[moved[strengths] == theta[strengths]]
    moved[still] += refits.settings.initial_step_share * (high - low)[still]
    return moved


Tangents = dict[tuple[int, str], np.ndarray]
"""Whitened tangents (parameters, n) of every trial and channel."""


class ScoringTangents(NamedTuple):
    """Tangents from which a round scores its candidates."""

    at: Fit
    """The fit at which the tangents were computed."""
    raw: list[np.ndarray] | None
    """Tangents (parameters, channels, samples) of each trial, or None if they are too large."""
    white: Tangents

    @classmethod
    def of(
        cls, refits: "Refits", at: Fit, raw: list[np.ndarray] | None = None
    ) -> "ScoringTangents":
        """Returns the tangents at a fit. If `raw` is None, they are computed.

        Large tangents are whitened in place.
        """
        problem = refits.problem
        if raw is None:
            raw = effect_tangents(problem, refits.entries, at.theta, at.free, refits.settings)
        large = sum(x.nbytes for x in raw) > MOST_KEPT
        white = problem.whitened(raw, refits.white, in_place=large)
        return cls(at, None if large else raw, white)

    def raw_of(self, names: Sequence[str], refits: "Refits") -> list[np.ndarray]:
        """Returns `raw` for the effects `names` and the fitted parameters; other rows may be 0."""
        if self.raw is not None:
            return self.raw
        shapes = [(len(self.at.theta), *r.values.shape) for r in refits.problem.records]
        none = [np.zeros(shape, np.float32) for shape in shapes]
        return renewed_tangents(
            none, refits.problem, refits.entries, self.at, names, refits.settings
        )


class FitStart(NamedTuple):
    """Start of a fit with another set of effects."""

    theta: np.ndarray
    free: np.ndarray
    """Indices of the entries of `theta` that are fitted."""
    null: np.ndarray
    """Parameters that can be simulated. A start that cannot be simulated is moved towards them."""
    J: Tangents | None = None
    """Tangents of the entries `free` (default: the tangents at the current fit)."""


def shape_starts(
    entries: Sequence[Parameter],
    theta: np.ndarray,
    shapes: Sequence[int],
    settings: SelectionSettings = DEFAULT_SETTINGS,
) -> list[np.ndarray]:
    """Returns `theta` with several values of the shape parameters `shapes` (indices).

    The first vector contains the defaults. In each other vector, one parameter has another value:
    its value in `theta`, its default times `shape_factor`, or its default divided by
    `shape_factor`. All values are inside the prior range, because a fit cannot leave a bound of the
    range.
    """
    first = theta.copy()
    first[shapes] = [entries[i].prior.null for i in shapes]
    found = [first]
    for i in shapes:
        prior = entries[i].prior
        margin = settings.initial_step_share * (prior.high - prior.low)
        factor = settings.shape_factor
        for x in dict.fromkeys([float(theta[i]), prior.null / factor, prior.null * factor]):
            other = first.copy()
            other[i] = np.clip(x, prior.low + margin, prior.high - margin)
            if x != prior.null:
                found.append(other)
    return found


class Estimate:
    """A fit by Broyden's method; the caller simulates the readings at `proposed`.

    The readings and residuals that it keeps have single precision, because dozens of fits run at
    the same time.
    """

    def __init__(
        self, refits: "Refits", current: Fit, start: FitStart, tangents: Tangents, judge: bool
    ):
        self.refits, self.current, self.start, self.judge = refits, current, start, judge
        self.proposed = start.theta
        self.tangents, self.corrections = tangents, list[BroydenCorrection]()
        self.bounds = Bounds.of([refits.entries[i] for i in start.free])
        self.best = Fit(start.theta, np.asarray(start.free), FAILED, 0, [], [], False)
        self.residuals: dict[tuple[int, str], np.ndarray] = {}
        self.step, self.share, self.expected = np.zeros(len(start.free)), 1.0, 0.0
        self.steps, self.halved, self.done = 0, 0, False

    def update(self, predicted: list[np.ndarray]) -> None:
        """Continues with the readings `predicted` at `proposed`."""
        refits, best = self.refits, self.best
        residuals = refits.problem.residuals(predicted, refits.white)
        square, samples = total(residuals), sum(len(r) for r in residuals.values())
        first = best.square == FAILED and self.halved < refits.settings.max_halvings - 1
        at_null = np.array_equal(self.proposed, self.start.null)
        if first and not self.judge and not at_null and square > self.current.square:
            # The start is worse than the current fit, which does not contain the effect.
            self.halved += 1
            self.proposed = 0.5 * (self.proposed + self.start.null)
            return
        if not square < best.square:
            self.halved += 1
            self.done = self.halved >= refits.settings.max_halvings
            if best.square < FAILED:
                self.share *= 0.5
                self._propose()
            else:
                self.proposed = 0.5 * (self.proposed + self.start.null)
            return
        J = self._derivatives()
        if best.square < FAILED:
            change = {key: r - residuals[key] for key, r in self.residuals.items()}
            step = (self.proposed - best.theta)[best.free]
            x = broyden_correction(J, change, step, summed(best.blocks)[0])
            self.corrections.append(x)
            J = x.of(J)
        blocks = normal_equations(residuals, J)
        self.residuals = {key: r.astype(np.float32) for key, r in residuals.items()}
        A, b = summed(blocks)
        theta, free = self.proposed, best.free
        self.step = linear_optimum(A, b, theta[free], self.bounds) - theta[free]
        gain = 2.0 * self.step @ b - self.step @ A @ self.step
        gained = self.current.square - square
        moved = max(0.0, -gained) if self.judge else abs(gained)
        least = max(
            refits.settings.estimate_tolerance * max(1.0, square / samples),
            refits.settings.estimate_tolerance_share * moved,
        )
        self.expected, self.done = square - gain, bool(abs(gain) < least)
        readings = [y.astype(np.float32) for y in predicted]
        self.best = Fit(theta, free, square, samples, blocks, readings, self.done)
        self.share, self.steps, self.halved = 1.0, self.steps + 1, 0
        self._propose()

    def _derivatives(self) -> Tangents:
        """Returns the present derivatives. Only their corrections are stored, to save memory."""
        J = self.start.J or {key: x[self.start.free] for key, x in self.tangents.items()}
        for x in self.corrections:
            J = x.of(J)
        return J

    def _propose(self) -> None:
        self.proposed = self.best.theta.copy()
        self.proposed[self.best.free] += self.share * self.step


@dataclass(frozen=True)
class Refits:
    """Refits of one problem with fixed whiteners, so that their sums of squares are comparable."""

    problem: AbstractProblem
    entries: Sequence[Parameter]
    white: dict[tuple[int, str], Whitener]
    progress: Callable[[str], None]
    settings: SelectionSettings = DEFAULT_SETTINGS
    meter: DiscrepancyMeter | None = None
    """Measures the discrepancies of a fit. None: the discrepancies of the noise apply."""

    def discrepancies(self, predicted: Sequence[np.ndarray]) -> dict[str, float]:
        """Returns the discrepancy of each channel if the model's readings are `predicted`."""
        if self.meter is None:
            return self.problem.discrepancies
        return {channel: x.used for channel, x in self.meter(predicted).items()}

    def sizes(self, before: Fit, after: Fit) -> dict[str, float]:
        """Returns each channel's rms change between two fits as a fraction of the channel's rms."""
        return relative_changes(self.problem, before.predicted, after.predicted)

    def fit(
        self,
        theta: np.ndarray,
        free: np.ndarray,
        exact: bool = False,
        least_decrease: Callable[[float], float] = lambda square: 0.0,
        linearised_at: np.ndarray | None = None,
    ) -> Fit:
        """Returns the fit of the parameters `free` (indices) that starts at `theta`.

        By default, the fit is not exact: the loop refits its final model to all trials.
        """
        return fit_gauss_newton(
            self.problem, self.entries, theta, free, self.progress, self.white, exact,
            least_decrease, linearised_at,
        )  # fmt: skip

    def null(self, theta: np.ndarray, group: np.ndarray) -> np.ndarray:
        """Returns theta with the parameters `group` (indices) at their null."""
        theta = theta.copy()
        theta[group] = [self.entries[i].prior.null for i in group]
        return theta

    def freed(self, fit: Fit, effects: Sequence[str]) -> Fit:
        """Returns `fit`, repeated with free shape parameters of `effects`."""
        groups = effect_entries(self.entries)
        shapes = [i for n in effects for i in groups[n] if self.entries[i].is_shape]
        shapes = [i for i in shapes if i not in fit.free]
        if not shapes:
            return fit
        self.progress(f"refitting with free {', '.join(self.entries[i].label for i in shapes)}")
        found = self.fit(fit.theta, np.concatenate([fit.free, shapes]))
        return found if found.converged and found.square <= fit.square else fit

    def raced(
        self, current: Fit, starts: Sequence[FitStart], tangents: Tangents, judge: bool = False
    ) -> list[Fit]:
        """Returns the best fit from each of `starts`, over several values of shape parameters.

        The tangents at the null of an effect do not depend on the effect's shape parameters. The
        first fits therefore use the fixed values of `shape_starts`. The best of these fits is then
        continued with free shape parameters. If `judge` is false, it is not continued if another
        start gains much more (`hopeless_share`). The result is the continued fit, or the fit with
        the defaults if the free parameters gain less than `least_gain` requires. With the setting
        `complete_refits`, each result is a complete fit with free shape parameters.
        """
        if self.settings.complete_refits:
            return [self._complete(current, x, tangents) for x in starts]
        shapes = [
            [int(i) for i in x.free if self.entries[i].is_shape and i not in current.free]
            for x in starts
        ]
        lanes = [
            (k, x._replace(theta=theta, free=x.free[~np.isin(x.free, own)]))
            for k, (x, own) in enumerate(zip(starts, shapes, strict=True))
            for theta in shape_starts(self.entries, x.theta, own, self.settings)
        ]
        found: list[list[Fit]] = [[] for _ in starts]
        fits = self.estimated(current, [x for _, x in lanes], tangents, judge)
        for (k, _), fit in zip(lanes, fits, strict=True):
            found[k].append(fit)
        most = max((current.square - fit.square for fit in fits), default=0.0)
        far = np.inf if judge else self.settings.hopeless_share * abs(most)
        more = []
        for k, x in enumerate(starts):
            best = min(found[k], key=lambda fit: fit.square)
            near = most - (current.square - best.square) <= far
            if shapes[k] and near and best.square < FAILED:
                added = ~np.isin(x.free, current.free)
                kept, own = x.free[~added], x.free[added]
                along = reading_derivatives(self.problem, self.entries, best.theta, own)
                J = self._joined(tangents, kept, along)
                if all(np.isfinite(x).all() for x in J.values()):
                    free = np.concatenate([kept, own])
                    more.append((k, FitStart(best.theta, free, best.theta, J)))
        freed = self.estimated(current, [x for _, x in more], tangents, judge, most)
        chosen = [each[0] for each in found]
        for (k, _), fit in zip(more, freed, strict=True):
            chosen[k] = max(chosen[k], fit, key=lambda fit: self.surplus(current, fit))
        return chosen

    def _joined(self, tangents: Tangents, kept: np.ndarray, along: list[np.ndarray]) -> Tangents:
        """Returns the rows `kept` of whitened `tangents`, then the derivatives `along`, whitened.

        The result has the precision of `tangents`.
        """
        white = self.problem.whitened(along, self.white)
        return {
            key: np.concatenate([x[kept], white[key]], dtype=x.dtype) for key, x in tangents.items()
        }

    def _complete(self, current: Fit, start: FitStart, tangents: Tangents) -> Fit:
        """Returns the fit of all parameters of `start`, continued until it has nearly converged."""
        share = self.settings.complete_tolerance_share

        def least_decrease(square: float) -> float:
            return share * min(square, abs(current.square - square))

        theta = self._complete_start(current, start, tangents)
        for _ in range(self.settings.max_halvings):
            found = self.fit(theta, start.free, least_decrease=least_decrease)
            if found.square < FAILED and np.isfinite(found.square):
                return found
            theta = 0.5 * (theta + start.null)
        return Fit(theta, np.asarray(start.free), FAILED, 0, [], [], False)

    def _complete_start(self, current: Fit, start: FitStart, tangents: Tangents) -> np.ndarray:
        """Returns the parameters from which a complete refit starts.

        The result has the smallest sum of squares of several fractions of a step. For an effect
        with a `Prior.start`, the step leads from the null to the start. Otherwise, the step is that
        of a linear fit of all parameters, with the best of the `shape_starts`.
        """
        added = [int(i) for i in start.free if i not in current.free]
        strengths = np.array([i for i in added if not self.entries[i].is_shape], int)
        if not len(strengths):
            return start.theta
        begin = self.null(start.theta, strengths)
        if any(self.entries[i].prior.start is not None for i in added):
            step = start.theta - begin
        else:
            begin, step = self._linear_step(current, start, begin, tangents)
        starts = [start.theta] + [
            inside(begin, step, start.free, self.entries, self.settings, share) for share in SHARES
        ]
        squares = [
            total(self.problem.residuals(list(predicted), self.white))
            for predicted in zip(*self.problem.coarse(starts), strict=True)
        ]
        return starts[int(np.argmin(squares))]

    def _linear_step(
        self, current: Fit, start: FitStart, null: np.ndarray, tangents: Tangents
    ) -> tuple[np.ndarray, np.ndarray]:
        """Returns `null` with the best shape parameters, and the step of a linear fit from there.

        The best of the `shape_starts` has the largest predicted gain.
        """
        added = [int(i) for i in start.free if i not in current.free]
        shapes = [i for i in added if self.entries[i].is_shape]
        kept = start.free[np.isin(start.free, current.free)]
        own = np.array([i for i in added if i not in shapes], int)
        both = np.concatenate([kept, own])
        residuals = self.problem.residuals([x[0] for x in self.problem.coarse([null])], self.white)
        lanes = shape_starts(self.entries, null, shapes, self.settings) if shapes else [null]
        found: list[tuple[float, int, np.ndarray]] = []
        for lane in lanes:
            more = self.problem.tangents(lane, np.eye(len(lane))[own])
            J = self._joined(tangents, kept, more)
            A, b = summed(normal_equations(residuals, J))
            step = np.zeros(len(lane))
            if np.isfinite(A).all() and np.isfinite(b).all():
                step[both] = inverse(A) @ b
            gain = float(step[both] @ b) if step.any() else 0.0
            found.append((gain, -len(found), step))
        _, best, step = max(found)
        return lanes[-best], step

    def surplus(self, current: Fit, fit: Fit) -> float:
        """Returns the gain of `fit` over `current`, minus the required gain."""
        added = int(np.sum(~np.isin(fit.free, current.free)))
        gain = (current.square - fit.square) / fit.inflation
        return gain - self.settings.least_gain(max(added, 1))

    def estimated(
        self,
        current: Fit,
        starts: Sequence[FitStart],
        tangents: Tangents,
        judge: bool = False,
        most: float = 0.0,
    ) -> list[Fit]:
        """Returns a fit from each of `starts`, with readings of the coarse mesh.

        The difference between the readings of the fine and the coarse mesh is taken from the fit
        `current`. `tangents` are the tangents at `current`; Broyden's formula corrects them after
        each step. All fits are simulated in one batch. A start that cannot be simulated is moved
        halfway to its `null`, at most `max_halvings` times. If it still fails, the sum of squares
        of the fit is `FAILED`.

        A fit without prospects ends early, without convergence: its expected gain is below the gain
        of another fit of the same parameters. After the first step, it must be far below this gain
        (`hopeless_share`). If `judge` is true, the first of these fits ends early only if it is
        also far below in absolute terms. If `judge` is false, a fit also ends if its expected gain
        is below the fraction `contender_gain_share` of the largest gain of all these fits. `most`
        replaces the largest gain if `most` is larger.
        """
        if not starts:
            return []
        coarse = self.problem.coarse([current.theta])
        offset = [y - x[0] for y, x in zip(current.predicted, coarse, strict=True)]
        fits = [Estimate(self, current, x, tangents, judge) for x in starts]
        for _ in range(self.settings.max_estimate_steps):
            active = [x for x in fits if not x.done]
            if not active:
                break
            readings = self.problem.coarse([x.proposed for x in active])
            for i, x in enumerate(active):
                x.update([y[i] + more for y, more in zip(readings, offset, strict=True)])
            most = max([most, *(current.square - x.best.square for x in fits)])
            for x in active:
                same = [y for y in fits if np.array_equal(y.start.free, x.start.free)]
                least = current.square - min(y.best.square for y in same)
                if not judge:
                    least = max(least, self.settings.contender_gain_share * most)
                margin = self.settings.hopeless_share * abs(least) if x.steps == 1 else 0.0
                if judge and x is same[0]:
                    factor = self.settings.removal_loss_factor
                    margin = max(margin, factor * self.settings.min_gain)
                x.done |= current.square - x.expected < least - margin
            for x in active:
                if x.done:  # frees the memory for the other fits
                    x.corrections, x.residuals = [], {}
        return [x.best for x in fits]

    def without(self, current: Fit, name: str) -> Fit | None:
        """Returns the fit without the effect `name`, or None if the effect is necessary."""
        group = effect_entries(self.entries)[name]
        own = np.isin(current.free, group)
        null = self.null(current.theta, group)
        # Without the effect, its shape parameters are not fitted either: they are nuisances here.
        strengths = np.array([i for i in group if not self.entries[i].is_shape])
        strong = np.isin(current.free, strengths)
        away = (current.theta - null)[strengths][np.isin(strengths, current.free)]
        A = summed(current.blocks)[0]
        loss = away @ np.linalg.pinv(inverse(A)[np.ix_(strong, strong)]) @ away / current.inflation
        if not loss < self.settings.removal_loss_factor * self.settings.min_gain:
            return None
        self.progress(f"refitting without {name}")
        less = self.fit(null, current.free[~own])
        gain = (less.square - current.square) / current.inflation
        sizes = self.sizes(less, current)
        limits = self.problem.discrepancies
        needed = self.settings.worth_naming(gain, sizes, limits, int(own.sum()))
        return less if less.converged and not needed else None
