"""Predicts the Fisher information of trials about a model's parameters, before the trials are run.

For every trial and channel, J (k, n) contains the tangents of the n readings y along k parameters,
and W whitens the declared noise:

    A = (W J) (W J)^T,    raw = J J^T,    square = y.y

A is the normal matrix of least squares. From `raw` and `square`, `channel_shares` computes the rms
change of a channel relative to the rms of its readings.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from calibration.inference.cache import Memo, cached, cached_each
from calibration.inference.gauss_newton import difference_step, takes_differences
from calibration.inference.noise import Noise, Whitener, channel_noise
from calibration.measurements.records import Record, declared_noise, load_records
from calibration.model.compiled import on_all_cores
from calibration.model.extended import BASE, Parameter, base_vector, model_parameters
from calibration.model.initial_swing import declared_swing_spans
from calibration.model.plan import COARSE, Resolution, TrialPlan, plan_trial
from calibration.model.predict import predict_each, predict_readings
from calibration.model.tangents import reading_tangents
from slider_jax.errors import InputError, SolverError
from slider_jax.experiment.load import Experiment
from slider_jax.experiment.schema import Trial
from slider_jax.simulation.effect_signature import typical_size

FINITE_START = 0.1
"""Step of a secant, as a fraction of the distance from the null to the far end of the prior range.
A secant replaces the tangent of an effect that is nonlinear at its null."""
MIN_COSINE = 0.9
"""An effect is nonlinear if the cosine between its tangent and its secant is below this value."""
MAX_LENGTH_RATIO = 1.5
"""An effect is also nonlinear if tangent and secant differ in length by more than this factor."""


@dataclass(frozen=True)
class SensorModel:
    """Noise and sample times of an experiment's sensors."""

    noise: dict[str, Noise]
    """Noise of each channel."""
    every: dict[str, int]
    """Number of samples per reading of a channel (2: every second sample has a reading)."""
    measured: dict[str, Record]
    """Measured trials by file name. The prediction uses the sample times of these trials."""
    fitted: Mapping[tuple[str, str], Noise] = field(default_factory=dict)
    """Noise of measured trials (file name and channel) in a fit."""

    @classmethod
    def of(
        cls,
        experiment: Experiment,
        found: Sequence[Record] | None = None,
        fitted: Mapping[tuple[str, str], Noise] | None = None,
    ) -> "SensorModel":
        """Returns the sensors of the measured trials `found`, or else the declared sensors.

        If `found` is None, the trials are read from their files. The declared sensors are used if
        no trial is measured. `fitted` is the noise of measured trials in a fit (default: estimated
        or declared). Raises `InputError` if no channel has a sensor.
        """
        fitted = fitted or {}
        if found is None:
            there = any((experiment.folder / t.file).exists() for t in experiment.trials)
            found = load_records(experiment) if there else []
        noise, every = {}, {}
        for channel, sensor in experiment.channels.items():
            recorded = [r for r in found if r.has(channel)]
            if recorded:
                each = [
                    fitted.get((r.trial.file, channel))
                    or channel_noise(experiment.sensors, sensor, r.values[r.row(channel)])
                    for r in recorded
                ]
                whites = [float(np.median(x.white)) for x in each]
                middle = int(np.argsort(whites)[len(each) // 2])
                noise[channel] = each[middle]._replace(white=whites[middle])
                share = np.mean([r.there(channel).mean() for r in recorded])
                every[channel] = max(1, round(1.0 / float(share)))
            elif not found and declared_noise(experiment.sensors, sensor) > 0.0:
                noise[channel] = channel_noise(experiment.sensors, sensor, np.zeros(2))
                every[channel] = 1
        if not noise:
            raise InputError(
                "sensors: no noise is declared and no trial is measured, so no detection limit can "
                "be computed; add sensors.pressure_noise, force_noise or tip_noise"
            )
        return cls(noise, every, {r.trial.file: r for r in found}, fitted)

    @property
    def discrepancies(self) -> dict[str, float]:
        """Returns the model-discretisation discrepancy of each channel as a fraction of its rms."""
        return {channel: noise.discrepancy for channel, noise in self.noise.items()}

    def noise_of(self, trial: Trial, channel: str) -> Noise:
        """Returns the noise of a channel in a trial."""
        return self.fitted.get((trial.file, channel), self.noise[channel])

    def samples(self, trial: Trial, channel: str, n: int) -> np.ndarray:
        """Returns, for each sample (n,) of a trial, whether the channel has a reading."""
        if trial.file in self.measured:
            return self.measured[trial.file].there(channel)
        return np.arange(n) % self.every[channel] == 0


class ChannelInformation(NamedTuple):
    """`A` (k, k), `raw` (k, k) and `square` (see module) of a channel's n readings in a trial."""

    trial: int
    channel: str
    A: np.ndarray
    raw: np.ndarray
    square: float
    n: int


@dataclass(frozen=True)
class TrialInformation:
    """Predicts the Fisher information of trials about the chosen parameters of a model."""

    experiment: Experiment
    effects: tuple[str, ...]
    """Effects that the compiled model contains."""
    theta: np.ndarray
    chosen: np.ndarray
    """Indices (k,) of the parameters in theta along which the tangents are computed."""
    sensing: SensorModel
    secants: dict[int, float]
    """Step, in SI units, of each parameter (index in theta) whose secant replaces the tangent."""
    coarse: Resolution = COARSE
    memo: Memo | None = None
    """Cache of simulated readings."""
    other: np.ndarray | None = None
    """Parameters of a second model. If they are given, the last of the k directions is the
    difference between the readings: second model minus this model."""

    @property
    def entries(self) -> list[Parameter]:
        """Returns the k chosen parameters."""
        every = model_parameters(self.effects)
        return [every[i] for i in self.chosen]

    def plan(self, trial: Trial) -> TrialPlan:
        """Returns the simulation inputs of a trial, with the sample times of a measured trial."""
        record = self.sensing.measured.get(trial.file)
        at = None if record is None else record.t
        return plan_trial(self.experiment, trial, self.effects, self.coarse, at)

    def trial(self, trial: Trial, number: int = 0) -> list[ChannelInformation]:
        """Returns the information of a trial; raises `SolverError` if the simulation fails."""
        p = self.plan(trial)
        y, J, *other = self._readings(trial, p)
        if not all(np.isfinite(x).all() for x in (y, *other)):
            raise SolverError(
                f"{trial.file}: the trial cannot be simulated with these parameters; check K_Q, "
                "stiffness and amplitude: the bending moment may be too large for the body"
            )
        J = np.stack([*J, *(x - y for x in other)])
        swing = declared_swing_spans(self.experiment, p, self.theta)
        found = []
        for channel in self.sensing.noise:
            noise = self.sensing.noise_of(trial, channel)
            row, here = (
                p.extended.channels.row(channel),
                self.sensing.samples(trial, channel, len(p.at)),
            )
            if here.sum() < 20:
                continue
            raw, signal = J[:, row, here], y[row, here]
            swings = None if swing is None else swing[:, row, here]
            white = Whitener(p.at[here], noise, signal, trial.frequency, swings)(raw)
            A, gram, square = white @ white.T, raw @ raw.T, float(signal @ signal)
            found.append(ChannelInformation(number, channel, A, gram, square, here.sum()))
        return found

    def _readings(self, trial: Trial, p: TrialPlan) -> list[np.ndarray]:
        """Returns the readings (channels, n) and the tangents (k, channels, n) of the model.

        If there is a second model, its readings follow. k is 0 if the simulation fails. Differences
        replace the tangents along few directions.
        """
        name = f"foresee {trial.model_dump_json()} {self.effects} {self.coarse}"
        others = [] if self.other is None else [self.other]
        if takes_differences(self.theta, self.chosen) and not self.secants:
            pairs = zip(self.chosen, self.entries, strict=True)
            steps = np.array([difference_step(x, self.theta[i]) for i, x in pairs])
            moved = self.theta + steps[:, None] * np.eye(len(self.theta))[self.chosen]
            y, *rest = self._predictions(name, p, [self.theta, *others, *moved])
            J = (np.stack(rest[len(others) :]) - y) / steps[:, None, None]
            return [y, J, *rest[: len(others)]]
        y, *other = self._predictions(name, p, [self.theta, *others])
        if not np.isfinite(y).all():
            return [y, np.zeros((0, *y.shape)), *other]
        secants = np.array(sorted(self.secants.items()), float)
        arrays = [self.theta, self.chosen, secants]
        found = cached(self.memo, f"{name} tangents", arrays, lambda: [self._tangents(p, y)])
        return [y, found[0], *other]

    def _predictions(
        self, name: str, p: TrialPlan, thetas: Sequence[np.ndarray]
    ) -> list[np.ndarray]:
        """Returns the readings with each of `thetas`."""
        keys = [(name, [x]) for x in thetas]
        return cached_each(
            self.memo, keys, lambda missing: predict_each([(p, thetas[i]) for i in missing])
        )

    def _tangents(self, p: TrialPlan, y: np.ndarray) -> np.ndarray:
        """Returns tangents or secants (k, channels, n); NaN where the simulation fails."""
        straight = [j for j, i in enumerate(self.chosen) if i not in self.secants]
        J = np.empty((len(self.chosen), len(p.extended.channels), len(p.at)))
        if straight:
            directions = np.eye(len(self.theta))[self.chosen[straight]]
            J[straight] = reading_tangents(p, self.theta, directions)
        for j, i in enumerate(self.chosen):
            if i in self.secants:
                J[j] = _secant(p, self.theta, y, int(i), self.secants[i])
        return J

    def trials(
        self, chosen: Sequence[Trial], progress: Callable[[str], None] = lambda text: None
    ) -> list[ChannelInformation]:
        """Returns the information of all `chosen` trials, computed on all cores."""
        done: list[int] = []

        def one(item: tuple[int, Trial]) -> list[ChannelInformation]:
            found = self.trial(item[1], item[0])
            done.append(item[0])
            progress(f"{item[1].file}: {len(self.chosen)} tangents ({len(done)} of {len(chosen)})")
            return found

        return [x for found in on_all_cores(one, list(enumerate(chosen))) for x in found]


def predict_information(
    experiment: Experiment,
    effects: Sequence[str],
    progress: Callable[[str], None] = lambda text: None,
    coarse: Resolution = COARSE,
    memo: Memo | None = None,
) -> TrialInformation:
    """Returns the `TrialInformation` of base parameters and `effects`, at the experiment's values.

    Shape parameters have their defaults. They are not among the chosen parameters, because they
    have no influence at the null of their effect.
    Raises `InputError` if the experiment has no fixed C_d and m_a, or declares no noise.
    """
    if experiment.parameters.force_coefficients == "ramp":
        raise InputError(
            'parameters.force_coefficients: given "ramp"; allowed here "fixed"; give one C_d and '
            "one m_a for all trials"
        )
    names = tuple(dict.fromkeys(effects))
    entries = model_parameters(names)
    theta = base_vector(entries, {n: getattr(experiment.parameters, n) for n in BASE})
    chosen = np.flatnonzero([not p.is_shape for p in entries])
    sensing = SensorModel.of(experiment)
    by_tangents = TrialInformation(experiment, names, theta, chosen, sensing, {}, coarse, memo)
    progress("comparing tangents with secants")
    return replace(by_tangents, secants=secant_steps(by_tangents))


def _secant(p: TrialPlan, theta: np.ndarray, y: np.ndarray, entry: int, step: float) -> np.ndarray:
    """Returns the change (channels, n) per unit of a parameter; `y` are the readings at theta."""
    moved = theta.copy()
    moved[entry] += step
    return (predict_readings(p, moved) - y) / step


def secant_steps(f: TrialInformation) -> dict[int, float]:
    """Returns the steps, in SI units, of the parameters that need a secant.

    These are the parameters that have a `Prior.start` or are nonlinear at the null in the
    experiment's shortest trial. If a secant cannot be simulated, the tangent is used.
    """
    p = min((f.plan(t) for t in f.experiment.trials), key=lambda p: p.grid.steps)
    y = predict_readings(p, f.theta)
    scale = np.std(y, axis=1)[:, None]
    scale = np.where(scale > 0.0, scale, 1.0)
    pairs = [(int(i), x.prior) for i, x in zip(f.chosen, f.entries, strict=True) if x.effect]
    if not pairs:
        return {}
    J = reading_tangents(p, f.theta, np.eye(len(f.theta))[[i for i, _ in pairs]])

    def one(item) -> tuple[int, float] | None:
        (i, prior), tangent = item
        if prior.start is not None:
            return i, prior.start - prior.null
        step = FINITE_START * (typical_size(prior) - prior.null)
        secant = (_secant(p, f.theta, y, i, step) / scale).ravel()
        return (i, step) if _is_nonlinear((tangent / scale).ravel(), secant) else None

    return dict(filter(None, on_all_cores(one, list(zip(pairs, J, strict=True)))))


def _is_nonlinear(tangent: np.ndarray, secant: np.ndarray) -> bool:
    if not np.isfinite(secant).all() or not secant.any():
        return False
    if not np.isfinite(tangent).all() or not tangent.any():
        return True
    sizes = float(np.linalg.norm(tangent)), float(np.linalg.norm(secant))
    cosine = float(tangent @ secant) / (sizes[0] * sizes[1])
    ratio = sizes[1] / sizes[0]
    return cosine < MIN_COSINE or not 1.0 / MAX_LENGTH_RATIO < ratio < MAX_LENGTH_RATIO


def information(channels: Sequence[ChannelInformation]) -> np.ndarray:
    """Returns the information (k, k) of all trials and channels."""
    return np.sum([x.A for x in channels], axis=0)


def channel_shares(channels: Sequence[ChannelInformation], step: np.ndarray) -> dict[str, float]:
    """Returns each channel's rms change by a step (k,), as a fraction of the channel's rms."""
    moved, found = np.flatnonzero(step), {}
    for channel in dict.fromkeys(x.channel for x in channels):
        parts = [x for x in channels if x.channel == channel]
        raw = np.sum([x.raw[np.ix_(moved, moved)] for x in parts], axis=0)
        square = float(np.sum([x.square for x in parts]))
        change = max(float(step[moved] @ raw @ step[moved]), 0.0)
        found[channel] = float(np.sqrt(change / max(square, 1e-300)))
    return found
