"""What trials would say of a model's parameters, before they are run.

Of every trial and channel, with J (k, n) the tangents of the readings along k parameters and W what
makes the declared noise white:

    A = (W J) (W J)^T,    raw = J J^T,    square = y.y

A is what least squares needs, `raw` and `square` say how large a change is beside the signal y.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calibration.inference.cache import Memo
from calibration.inference.noise import Noise, Whitener, channel_noise
from calibration.inference.problem import ChannelBlock
from calibration.measurements.records import Record, records
from calibration.model.extended import BASE, Parameter, base_vector, parameters
from calibration.model.initial_swing import declared_spans
from calibration.model.predict import (
    COARSE,
    Resolution,
    TrialPlan,
    on_all_cores,
    plan,
    predict,
    tangents,
)
from slider_jax.channels import CHANNELS, row_of
from slider_jax.errors import InputError, SolverError
from slider_jax.experiment.load import Experiment
from slider_jax.experiment.schema import Trial
from slider_jax.simulation.effect_signature import typical

FINITE_START = 0.1
"""Share of the prior range at which a secant stands for a tangent that tells too little."""
STRAIGHT = 0.9
"""cos of tangent and secant below which the tangent tells too little."""
LIKE = 1.5
"""Factor by which their lengths may differ."""


@dataclass(frozen=True)
class SensorModel:
    """The sensors of an experiment: noise of each channel, every how many samples it reads."""

    noise: dict[str, Noise]
    every: dict[str, int]
    measured: dict[str, Record]
    """By file; their own samples count."""

    @classmethod
    def of(cls, experiment: Experiment, found: Sequence[Record] | None = None) -> "SensorModel":
        """From the measured trials `found`, else from what the experiment declares.

        By default the trials' files are read. A channel without either is taken for a sensor that
        the tank lacks. Raises `InputError` where none is left.
        """
        if found is None:
            there = any((experiment.folder / t.file).exists() for t in experiment.trials)
            found = records(experiment) if there else []
        noise, every = {}, {}
        for channel in CHANNELS:
            recorded = [r for r in found if r.has(channel)]
            if recorded:
                each = [
                    channel_noise(experiment.sensors, channel, r.values[row_of(channel)])
                    for r in recorded
                ]
                noise[channel] = sorted(each)[len(each) // 2]
                share = np.mean([r.there(channel).mean() for r in recorded])
                every[channel] = max(1, round(1.0 / float(share)))
            elif not found and _is_declared(experiment, channel):
                noise[channel] = channel_noise(experiment.sensors, channel, np.zeros(2))
                every[channel] = 1
        if not noise:
            raise InputError(
                "sensors: no noise is declared and nothing is measured; what can be detected is "
                "judged against noise: add sensors.pressure_noise, force_noise or tip_noise"
            )
        return cls(noise, every, {r.trial.file: r for r in found})

    def samples(self, trial: Trial, channel: str, n: int) -> np.ndarray:
        """(n,) whether a sample of the channel is there."""
        if trial.file in self.measured:
            return self.measured[trial.file].there(channel)
        return np.arange(n) % self.every[channel] == 0


def _is_declared(experiment: Experiment, channel: str) -> bool:
    sensors = experiment.sensors
    key = CHANNELS[channel].noise
    return bool(key) and getattr(sensors, key) > 0.0


class ChannelInformation(NamedTuple):
    """What one trial and channel would say along k directions: parameters, or another model."""

    trial: int
    channel: str
    A: np.ndarray
    raw: np.ndarray
    square: float
    n: int


@dataclass(frozen=True)
class TrialInformation:
    """A model, the parameters asked about, and the sensors: what is needed to foresee a trial."""

    experiment: Experiment
    effects: tuple[str, ...]
    """Of the extended model; programs are compiled for all of them."""
    theta: np.ndarray
    chosen: np.ndarray
    """(k,) entries of theta that the tangents are along."""
    sensing: SensorModel
    secants: dict[int, float]
    """Step of the entries whose tangent tells too little."""
    coarse: Resolution = COARSE
    memo: Memo | None = None
    """Keeps what was simulated."""
    other: np.ndarray | None = None
    """Parameters of another model. What it would read less what this one does is one tangent more
    then, the last."""

    @property
    def entries(self) -> list[Parameter]:
        """The k parameters that the tangents are along."""
        every = parameters(self.effects)
        return [every[i] for i in self.chosen]

    def plan(self, trial: Trial) -> TrialPlan:
        """The trial on its grid: a measured one's is that of its record."""
        record = self.sensing.measured.get(trial.file)
        at = None if record is None else record.t
        return plan(self.experiment, trial, self.effects, self.coarse, at)

    def trial(self, trial: Trial, number: int = 0) -> list[ChannelInformation]:
        """What a trial would say. Raises `SolverError` where it cannot be simulated."""
        p = self.plan(trial)
        y, J = self._kept(trial, p)
        other = self._other(trial, p)
        if not np.isfinite(y).all() or not (other is None or np.isfinite(other).all()):
            raise SolverError(
                f"{trial.file}: cannot be simulated with these parameters; check K_Q, stiffness "
                "and amplitude: the chambers may bend the body further than it can go"
            )
        if other is not None:
            J = np.stack([*J, other - y])
        swing = declared_spans(self.experiment, p, self.theta)
        found = []
        for channel, noise in self.sensing.noise.items():
            row, here = row_of(channel), self.sensing.samples(trial, channel, len(p.at))
            if here.sum() < 20:
                continue
            raw, signal = J[:, row, here], y[row, here]
            swings = None if swing is None else swing[:, row, here]
            white = Whitener(p.at[here], noise, signal, channel, trial.frequency, swings)(raw)
            gram = raw @ raw.T
            found.append(
                ChannelInformation(
                    number, channel, white @ white.T, gram, float(signal @ signal), here.sum()
                )
            )
        return found

    def _kept(self, trial: Trial, p: TrialPlan) -> list[np.ndarray]:
        """Readings (5, n) of a trial and their tangents (k, 5, n); none of what did not end."""

        def make() -> list[np.ndarray]:
            y = predict(p, self.theta)
            fine = np.isfinite(y).all()
            return [y, self._along(p, y) if fine else np.zeros((0, *y.shape))]

        if self.memo is None:
            return make()
        steps = np.array(sorted(self.secants.items()), float)
        name = f"foresee {trial.model_dump_json()} {self.effects} {self.coarse}"
        return self.memo.cached(name, [self.theta, self.chosen, steps], make)

    def _other(self, trial: Trial, p: TrialPlan) -> np.ndarray | None:
        """Readings (5, n) of the other model."""
        other = self.other
        if other is None:
            return None
        if self.memo is None:
            return predict(p, other)
        name = f"foresee other {trial.model_dump_json()} {self.effects} {self.coarse}"
        return self.memo.cached(name, [other], lambda: [predict(p, other)])[0]

    def _along(self, p: TrialPlan, y: np.ndarray) -> np.ndarray:
        """(k, 5, n); NaN along what cannot be simulated."""
        straight = [j for j, i in enumerate(self.chosen) if i not in self.secants]
        directions = np.eye(len(self.theta))[self.chosen[straight]]
        J = np.empty((len(self.chosen), len(CHANNELS), len(p.at)))
        if straight:
            J[straight] = tangents(p, self.theta, directions)
        for j, i in enumerate(self.chosen):
            if i in self.secants:
                J[j] = secant(p, self.theta, y, int(i), self.secants[i])
        return J

    def trials(
        self, chosen: Sequence[Trial], progress: Callable[[str], None] = lambda text: None
    ) -> list[ChannelInformation]:
        """What trials would say, on all cores."""
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
    """At the experiment's own parameters, along the base model's and those of `effects`.

    Raises `InputError` where the experiment fixes no starting values or declares no noise.
    """
    if experiment.parameters.force_coefficients == "ramp":
        raise InputError(
            'parameters.force_coefficients: given "ramp"; allowed here "fixed": give one C_d and '
            "one m_a for all trials"
        )
    names = tuple(dict.fromkeys(effects))
    entries = parameters(names)
    theta = base_vector(entries, {n: getattr(experiment.parameters, n) for n in BASE})
    chosen, sensing = np.arange(len(entries)), SensorModel.of(experiment)
    bare = TrialInformation(experiment, names, theta, chosen, sensing, {}, coarse, memo)
    progress("comparing tangents with finite steps")
    return replace(bare, secants=finite_starts(bare))


def secant(p: TrialPlan, theta: np.ndarray, y: np.ndarray, entry: int, step: float) -> np.ndarray:
    """(5, n) change of the readings, `y` at theta, per change of an entry by `step`."""
    moved = theta.copy()
    moved[entry] += step
    return (predict(p, moved) - y) / step


def finite_starts(f: TrialInformation) -> dict[int, float]:
    """Entries whose tangent at the null says little of a tenth of the prior range, and that step.

    Those with a start are taken at it. Judged on the experiment's shortest trial. One that cannot
    be simulated there keeps its tangent.
    """
    p = min((f.plan(t) for t in f.experiment.trials), key=lambda p: p.grid.steps)
    y = predict(p, f.theta)
    scale = np.std(y, axis=1)[:, None]
    scale = np.where(scale > 0.0, scale, 1.0)
    asked = [(i, x) for i, x in zip(f.chosen, f.entries, strict=True) if x.effect]
    if not asked:
        return {}
    J = tangents(p, f.theta, np.eye(len(f.theta))[[i for i, _ in asked]])

    def one(item) -> tuple[int, float] | None:
        (i, x), tangent = item
        if x.prior.start is not None:
            return int(i), x.prior.start - x.prior.null
        step = FINITE_START * (typical(x.prior) - x.prior.null)
        finite = (secant(p, f.theta, y, int(i), step) / scale).ravel()
        return (int(i), step) if _tells_little((tangent / scale).ravel(), finite) else None

    found = on_all_cores(one, list(zip(asked, J, strict=True)))
    return dict(x for x in found if x is not None)


def _tells_little(tangent: np.ndarray, finite: np.ndarray) -> bool:
    if not np.isfinite(finite).all() or not finite.any():
        return False
    if not np.isfinite(tangent).all() or not tangent.any():
        return True
    sizes = float(np.linalg.norm(tangent)), float(np.linalg.norm(finite))
    straight = float(tangent @ finite) / (sizes[0] * sizes[1])
    return straight < STRAIGHT or not bool(1.0 / LIKE < sizes[1] / sizes[0] < LIKE)


def information(channels: Sequence[ChannelInformation]) -> np.ndarray:
    """(k, k) normal matrix of all trials and channels."""
    return np.sum([x.A for x in channels], axis=0)


def channel_shares(channels: Sequence[ChannelInformation], step: np.ndarray) -> dict[str, float]:
    """By what share of its rms a step (k,) changes each channel, all trials together."""
    known, found = np.flatnonzero(step), {}
    for channel in dict.fromkeys(x.channel for x in channels):
        parts = [x for x in channels if x.channel == channel]
        raw = np.sum([x.raw[np.ix_(known, known)] for x in parts], axis=0)
        square = float(np.sum([x.square for x in parts]))
        change = max(float(step[known] @ raw @ step[known]), 0.0)
        found[channel] = float(np.sqrt(change / max(square, 1e-300)))
    return found


def as_block(A: np.ndarray) -> list[ChannelBlock]:
    """A normal matrix as the evidence that `trace` takes, without a residual."""
    return [ChannelBlock(0, "", A, np.zeros(len(A)), 0.0, 0)]
