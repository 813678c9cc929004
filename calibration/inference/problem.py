"""Fitting problems: simulated trials, whitened residuals and their normal equations.

For every trial and channel, the normal equations contain

    A = J J^T,    b = J r,    c = r.r

with the whitened residual r (n,) and the derivatives J (parameters, n) of the whitened readings.
Fits, cross-validation and equivalence classes are computed from sums of A, b and c only.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, Self, final

import numpy as np

from calibration.inference.cache import Memo, cached, cached_each
from calibration.inference.measured_noise import ChannelNoise
from calibration.inference.noise import (
    Noise,
    StationaryWhitener,
    Whitener,
    channel_noise,
    declared_shares,
    discrepancy_scale,
)
from calibration.measurements.records import Record
from calibration.model.compiled import on_all_cores, slices
from calibration.model.extended import (
    acting_entries,
    base_values,
    base_vector,
    model_parameters,
    tangent_entries,
)
from calibration.model.initial_swing import swing_spans
from calibration.model.plan import COARSE, FINE, Resolution, TrialPlan, plan_trial
from calibration.model.predict import compile_readings, predict_each
from calibration.model.tangents import compile_tangents, reading_tangents
from slider_jax.channels import ChannelSet
from slider_jax.experiment.load import Experiment
from slider_jax.experiment.prepare import prepare


class Swing(NamedTuple):
    """Swing of the robot that remains from the previous trial when a trial starts."""

    size: float
    """Standard deviation of the swing at the tip [m]."""
    theta: np.ndarray
    """Parameters with which the change of the readings by the swing is simulated."""


FAILED = 1e12
"""Sum of squares of a channel whose simulation failed; larger than any other sum of squares."""


class ChannelBlock(NamedTuple):
    """Normal equations of one trial and channel (`n` samples) at one parameter vector."""

    trial: int
    channel: str
    A: np.ndarray
    b: np.ndarray
    c: float
    n: int


def summed(blocks: Sequence[ChannelBlock]) -> tuple[np.ndarray, np.ndarray]:
    """Returns the sums of A and b over all blocks."""
    return np.sum([x.A for x in blocks], axis=0), np.sum([x.b for x in blocks], axis=0)


def normal_equations(
    residuals: dict[tuple[int, str], np.ndarray], J: dict[tuple[int, str], np.ndarray]
) -> list[ChannelBlock]:
    """Returns the normal equations of whitened residuals (n,) and derivatives (parameters, n).

    The sums have double precision, also if the derivatives have single precision.
    """

    def block(key: tuple[int, str], r: np.ndarray) -> ChannelBlock:
        along = J[key]
        moving = np.flatnonzero(along.any(axis=1))
        A, b = np.zeros((len(along), len(along))), np.zeros(len(along))
        for here in slices(len(r), len(moving)):
            x = along[moving, here].astype(float)
            A[np.ix_(moving, moving)] += x @ x.T
            b[moving] += x @ r[here]
        return ChannelBlock(*key, A, b, float(r @ r), len(r))

    return [block(key, r) for key, r in residuals.items()]


def trial_equations(
    residuals: dict[tuple[int, str], np.ndarray], J: dict[tuple[int, str], np.ndarray]
) -> list[ChannelBlock]:
    """Returns one block per trial: the sum of `normal_equations` over its channels.

    The name of the channel is empty.
    """

    def block(trial: int) -> ChannelBlock:
        own = normal_equations({key: r for key, r in residuals.items() if key[0] == trial}, J)
        A, b = summed(own)
        return ChannelBlock(trial, "", A, b, sum(x.c for x in own), sum(x.n for x in own))

    return [block(trial) for trial in dict.fromkeys(trial for trial, _ in residuals)]


def products(J: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Returns J r of derivatives J (k, n) and a residual r (n,), with double precision."""
    found = np.zeros(len(J))
    for here in slices(len(r), len(J)):
        found += J[:, here].astype(float) @ r[here]
    return found


class Affine(NamedTuple):
    """Map from a fitted vector x to the parameters of one trial: offset + matrix x."""

    offset: np.ndarray
    """Parameters (parameters,) of the trial for x = 0."""
    matrix: np.ndarray
    """Derivative (parameters, entries of x) of the parameters with respect to x."""

    def at(self, x: np.ndarray) -> np.ndarray:
        return self.offset + self.matrix @ x


@dataclass(frozen=True, kw_only=True)
class AbstractProblem(ABC):
    """Measured trials, and a simulation that predicts their readings."""

    records: list[Record]
    channels: tuple[str, ...]
    noise: dict[tuple[int, str], Noise]
    memo: Memo | None = None
    """Cache of simulated readings."""
    declared: Mapping[str, float] = field(default_factory=dict)
    """Declared model-discretisation discrepancies, as fractions of the channel's rms."""
    _stationary: dict[tuple[str, str], StationaryWhitener] = field(
        default_factory=dict, repr=False, compare=False
    )
    """The last whitener of each trial and channel; problems that `replace` makes share them."""

    @property
    def all_channels(self) -> ChannelSet:
        """All channels of the experiment, in the order of the rows of readings."""
        return self.records[0].channels

    @property
    def discrepancies(self) -> dict[str, float]:
        """Returns each channel's discrepancy in the noise, as a fraction of the channel's rms."""
        return {channel: noise.discrepancy for (_, channel), noise in self.noise.items()}

    def with_discrepancies(self, found: Mapping[str, float]) -> Self:
        """Returns this problem with the discrepancies `found` of channels in the noise."""
        noise = {
            key: x._replace(discrepancy=found.get(key[1], x.discrepancy))
            for key, x in self.noise.items()
        }
        return replace(self, noise=noise)

    @property
    def mesh_ratio(self) -> float:
        """Returns the number of cells of the fine mesh divided by the number of the coarse mesh."""
        return 1.0

    @abstractmethod
    def _predict(self, theta: np.ndarray) -> list[np.ndarray]: ...

    @abstractmethod
    def _tangents(self, theta: np.ndarray, directions: np.ndarray) -> list[np.ndarray]: ...

    @abstractmethod
    def _coarse(self, thetas: Sequence[np.ndarray]) -> list[np.ndarray]: ...

    def on_coarse_mesh(self) -> "AbstractProblem":
        """Returns this problem with the mesh of the tangents for all simulations."""
        return self

    @abstractmethod
    def spans(self) -> list[np.ndarray] | None:
        """Returns changes (2, channels, samples) of each trial's readings by the initial swing.

        The two changes are for the swing's position and speed. None: the trials start at rest.
        """

    def predict(self, theta: np.ndarray) -> list[np.ndarray]:
        """Returns the readings (channels, samples) of every trial."""
        return self._cached("predict", [theta], lambda: self._predict(theta))

    def tangents(self, theta: np.ndarray, directions: np.ndarray) -> list[np.ndarray]:
        """Returns derivatives (k, channels, samples) of each trial's readings in k `directions`.

        The caller may change the arrays.
        """
        return self._cached(
            "tangents", [theta, directions], lambda: self._tangents(theta, directions)
        )

    def coarse(self, thetas: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Returns each trial's readings (k, channels, samples) with k parameter vectors.

        The simulations use the mesh that gives the tangents. The caller may change the arrays.
        """
        return self._cached("coarse", thetas, lambda: self._coarse(thetas))

    def secants(self, theta: np.ndarray, others: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Returns changes (k, channels, samples) of trials' readings from `theta` to `others`."""
        found = self.coarse([theta, *others])
        for y in found:
            y[1:] -= y[:1]
        return [y[1:] for y in found]

    def _cached(self, kind: str, arrays: Sequence[np.ndarray], make) -> list[np.ndarray]:
        return cached(self.memo, f"{kind} {[r.trial.file for r in self.records]}", arrays, make)

    def whiteners(self, predicted: list[np.ndarray]) -> dict[tuple[int, str], Whitener]:
        """Returns the whitener of every trial and channel; `predicted` are the model's readings."""
        swing = self.spans()

        def one(key):
            i, channel = key
            r = self.records[i]
            there = r.there(channel)
            row = r.row(channel)
            model = np.nan_to_num(predicted[i][row][there])
            swings = None if swing is None else swing[i][:, row, there]
            noise, t, frequency = self.noise[key], r.t[there], r.trial.frequency
            scale = discrepancy_scale(noise, model)
            name = r.trial.file, channel
            stationary = self._stationary.get(name)
            if stationary is None or not stationary.serves(t, noise, scale, frequency):
                stationary = StationaryWhitener(t, noise, scale, frequency)
                self._stationary[name] = stationary
            return key, Whitener(t, noise, model, frequency, swings, stationary)

        return dict(on_all_cores(one, list(self.noise)))

    def release_whiteners(self) -> None:
        """Frees the memory of the stored whiteners. `whiteners` makes new ones when necessary."""
        self._stationary.clear()

    def residuals(
        self, predicted: list[np.ndarray], white: dict[tuple[int, str], Whitener]
    ) -> dict[tuple[int, str], np.ndarray]:
        """Returns the whitened residuals, measured minus predicted, of every trial and channel."""
        found = {}
        for key, whiten in white.items():
            i, channel = key
            r, row = self.records[i], self.records[i].row(channel)
            found[key] = whiten((r.values[row] - predicted[i][row])[r.there(channel)])[0]
        return found

    def whitened(
        self,
        changes: list[np.ndarray],
        white: dict[tuple[int, str], Whitener],
        in_place: bool = False,
    ) -> dict[tuple[int, str], np.ndarray]:
        """Returns the whitened `changes` (k, channels, samples) of each trial's readings.

        The result has an array (k, n) for every trial and channel, with the precision of `changes`.
        If `in_place` is true, the result replaces the `changes` in their memory.
        """

        def one(key):
            i, channel = key
            r = self.records[i]
            series, there = changes[i][:, r.row(channel)], r.there(channel)
            k, n = len(series), int(there.sum())
            found = series[:, :n] if in_place else np.zeros((k, n), series.dtype)
            moving = np.flatnonzero(series.any(axis=1))
            for rows in slices(len(moving), len(there)):
                here = moving[rows]
                some = series[here]
                found[here] = white[key](some if n == len(there) else some[:, there])
            return key, found

        return dict(on_all_cores(one, list(white)))

    def blocks(
        self,
        residuals: dict[tuple[int, str], np.ndarray],
        derivatives: list[np.ndarray],
        white: dict[tuple[int, str], Whitener],
    ) -> list[ChannelBlock]:
        """Returns the normal equations of every trial and channel."""
        return normal_equations(residuals, self.whitened(derivatives, white))


@final
@dataclass(frozen=True, kw_only=True)
class TankProblem(AbstractProblem):
    """Trials of the robot in the tank, with plans for fine and coarse simulations."""

    fine: list[TrialPlan]
    coarse_plans: list[TrialPlan]
    mesh: Resolution = COARSE
    """Mesh and time step of the simulations that give the tangents."""
    maps: tuple[Affine, ...] | None = None
    """Map from the fitted vector to each trial's parameters. None: all trials use the vector."""
    swing: Swing | None = None
    _last: dict[bytes, list[np.ndarray]] = field(
        init=False, default_factory=dict, repr=False, compare=False
    )

    @classmethod
    def of(
        cls,
        experiment: Experiment,
        records: list[Record],
        effects: tuple[str, ...],
        channels: tuple[str, ...] | None = None,
        fine: Resolution = FINE,
        coarse: Resolution = COARSE,
        measured: Mapping[str, ChannelNoise] | None = None,
    ) -> "TankProblem":
        """Returns the problem of an experiment's `records` for the extended model with `effects`.

        `channels` are the fitted channels (default: all). Channels without readings in any trial
        are left out: the change of a reading that no sensor measured is no evidence. The noise is
        the declared noise, unless `measured` replaces it.
        """
        known = experiment.channels
        wanted = tuple(known) if channels is None else channels
        channels = tuple(c for c in wanted if any(r.has(c) for r in records))
        prepared = [prepare(experiment, r.trial, sample_times=r.t) for r in records]
        plans = [
            [plan_trial(experiment, trial, effects, resolution) for trial in prepared]
            for resolution in (fine, coarse)
        ]
        noise = {
            (i, channel): channel_noise(
                experiment.sensors, known[channel], r.values[r.row(channel)]
            )
            for i, r in enumerate(records)
            for channel in channels
            if r.has(channel)
        }
        if measured:
            noise = {key: measured[key[1]].of_trial(x) for key, x in noise.items()}
        swing, size = None, experiment.sensors.start_swing
        if size > 0.0:
            swing = Swing(size, base_vector(model_parameters(effects), base_values(experiment)))
        return cls(
            records=records,
            channels=channels,
            noise=noise,
            fine=plans[0],
            coarse_plans=plans[1],
            mesh=coarse,
            swing=swing,
            declared={
                channel: discrepancy
                for channel in channels
                if (discrepancy := declared_shares(experiment.sensors, known[channel])[1])
                is not None
            },
        )

    def part(self, chosen: Sequence[int]) -> "TankProblem":
        """Returns the problem of the trials with the indices `chosen`."""
        return replace(
            self,
            records=[self.records[i] for i in chosen],
            noise={
                (k, channel): self.noise[i, channel]
                for k, i in enumerate(chosen)
                for channel in self.channels
                if (i, channel) in self.noise
            },
            fine=[self.fine[i] for i in chosen],
            coarse_plans=[self.coarse_plans[i] for i in chosen],
        )

    def during(self, chosen: Callable[[Record], np.ndarray]) -> "TankProblem":
        """Returns the problem of only some readings.

        `chosen` returns the mask (n,) of the samples of a record that the problem contains. The
        simulations are the same, so both problems share their cache.
        """
        masks = [chosen(r) for r in self.records]
        records = [
            replace(r, values=np.where(mask, r.values, np.nan))
            for r, mask in zip(self.records, masks, strict=True)
        ]
        noise = {}
        for (i, channel), x in self.noise.items():
            if records[i].has(channel):
                there = self.records[i].there(channel)
                white = np.broadcast_to(x.white, there.sum())[masks[i][there]]
                noise[i, channel] = x if np.isscalar(x.white) else x._replace(white=white)
        return replace(self, records=records, noise=noise, _stationary={})

    def on_coarse_mesh(self) -> "TankProblem":
        # The names of cached readings do not contain the mesh.
        return replace(self, fine=self.coarse_plans, memo=None)

    @property
    def mesh_ratio(self) -> float:
        fine, coarse = (x[0].numerics for x in (self.fine, self.coarse_plans))
        return (fine.tail_cells + fine.body_cells) / (coarse.tail_cells + coarse.body_cells)

    def compilations(self, theta: np.ndarray) -> list[Callable[[], None]]:
        """Returns calls that compile the programs of readings and tangents, in the order of use."""
        i = int(np.argmin([p.grid.steps for p in self.fine]))
        fine, coarse = self.fine[i], self.coarse_plans[i]
        needed = tangent_entries(model_parameters(coarse.extended.effects), theta)
        return [
            lambda: compile_readings(fine, theta),
            lambda: compile_tangents(coarse, theta, np.eye(len(theta))[needed]),
            lambda: compile_readings(coarse, theta),
        ]

    def spans(self) -> list[np.ndarray] | None:
        return self._spans

    @cached_property
    def _spans(self) -> list[np.ndarray] | None:
        swing = self.swing
        if swing is None:
            return None
        return self._cached(
            f"swing {swing.size}",
            [swing.theta],
            lambda: on_all_cores(
                lambda p: swing_spans(p, swing.theta, swing.size), self.coarse_plans
            ),
        )

    def predict(self, theta: np.ndarray) -> list[np.ndarray]:
        return self._cached_each("predict", [theta], lambda part: part._predict(theta))

    def coarse(self, thetas: Sequence[np.ndarray]) -> list[np.ndarray]:
        return self._cached_each("coarse", thetas, lambda part: part._coarse(thetas))

    def _cached_each(
        self,
        kind: str,
        arrays: Sequence[np.ndarray],
        make: Callable[["TankProblem"], list[np.ndarray]],
    ) -> list[np.ndarray]:
        """Returns `make(self)`; each trial has a cache of its own, for problems of other trials."""
        if self.memo is None or self.maps is not None:
            return make(self)
        keys = [(f"{kind} {r.trial.file}", arrays) for r in self.records]
        return cached_each(self.memo, keys, lambda missing: make(self.part(missing)))

    def _predict(self, theta: np.ndarray) -> list[np.ndarray]:
        return self.predict_each(self._own(theta))

    def predict_each(self, thetas: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Returns the readings (channels, samples) of each trial i with parameters `thetas[i]`."""
        return predict_each(list(zip(self.fine, thetas, strict=True)))

    def _coarse(self, thetas: Sequence[np.ndarray]) -> list[np.ndarray]:
        each = [self._own(theta) for theta in thetas]
        pairs = [(p, x[i]) for i, p in enumerate(self.coarse_plans) for x in each]
        found = predict_each(pairs)[::-1]
        return [_stacked([found.pop() for _ in thetas]) for _ in self.coarse_plans]

    def _tangents(self, theta: np.ndarray, directions: np.ndarray) -> list[np.ndarray]:
        if self.maps is None:
            rows, units = np.nonzero(directions)
            entries = model_parameters(self.coarse_plans[0].extended.effects)
            needed = tangent_entries(entries, theta)
            other = np.setdiff1d(acting_entries(entries, theta), needed)
            single = len(rows) == len(np.unique(rows)) and np.all(directions[rows, units] == 1.0)
            if single and not np.isin(units, other).any():
                wanted = np.full(len(directions), -1)
                wanted[rows] = units
                return self._unit_tangents(theta, needed, wanted)
            return on_all_cores(lambda p: reading_tangents(p, theta, directions), self.coarse_plans)

        along = [directions @ m.matrix.T for m in self.maps]
        jobs = list(zip(self.coarse_plans, self._own(theta), along, strict=True))
        return on_all_cores(lambda job: reading_tangents(*job), jobs)

    def _unit_tangents(
        self, theta: np.ndarray, needed: np.ndarray, wanted: np.ndarray
    ) -> list[np.ndarray]:
        """Returns the derivatives by the entries `wanted` (indices), with single precision.

        A fit and the scoring after the fit need different entries at the same `theta`. The
        derivatives by all entries `needed` are therefore computed. They are kept until the scoring
        wants a row for each entry of `theta`. All other derivatives are zero, and so are those by
        the entry -1.
        """
        key, count = theta.tobytes(), len(theta)
        if key not in self._last:
            self._last.clear()
            unit = np.zeros((count, count))
            unit[needed, needed] = 1.0
            self._last[key] = on_all_cores(
                lambda p: reading_tangents(p, theta, unit, np.float32), self.coarse_plans
            )
        moving = np.flatnonzero(wanted >= 0)
        if len(wanted) == count and np.array_equal(wanted[moving], moving):
            whole = self._last.pop(key)
            for x in whole:
                x[np.setdiff1d(needed, moving)] = 0.0
            return whole

        def rows(x: np.ndarray) -> np.ndarray:
            found = np.zeros((len(wanted), *x.shape[1:]), np.float32)
            found[moving] = x[wanted[moving]]
            return found

        return [rows(x) for x in self._last[key]]

    def _own(self, theta: np.ndarray) -> list[np.ndarray]:
        """Returns the parameters of each trial for the fitted vector `theta`."""
        return [theta] * len(self.fine) if self.maps is None else [m.at(theta) for m in self.maps]


def _stacked(arrays: list[np.ndarray]) -> np.ndarray:
    """Returns one array of `arrays` of one shape. The list is emptied, which frees memory."""
    arrays.reverse()
    found = np.empty((len(arrays), *arrays[0].shape), arrays[0].dtype)
    for row in found:
        row[...] = arrays.pop()
    return found


def total(residuals: dict[tuple[int, str], np.ndarray]) -> float:
    """Returns the sum of squares of all whitened residuals; failed channels count as `FAILED`."""
    parts = [float(r @ r) for r in residuals.values()]
    return sum(x if np.isfinite(x) else FAILED for x in parts)
