"""The live twin: a calibrated model runs beside a stream of readings.

    twin = Twin.of(experiment)                 # compiles; before the stream starts
    for block in twin.feed(readings):          # as they come
        block.model, block.residual, block.k, block.K_Q, block.alarm

After `WARM_UP` the bands of the residuals are learned from some strides; then the alarm is on.
k and K_Q follow the stream all the time, except where the residual leaves its band.
"""

import time
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from calibration.model.extended import BASE
from calibration.twin.alarm import NO_ALARM, Alarm, Bands, Watch, Window, misfits
from calibration.twin.block import (
    PAST,
    VALUES,
    BlockLayout,
    compiled,
    initial_block_state,
    live_model,
    values_of,
)
from calibration.twin.estimate import ParameterEstimate, Recursive, pull_of_lag, pull_of_moment
from calibration.twin.stream import GapFiller, Samples, UniformBlock
from slider_jax.beam.grid import split_cells
from slider_jax.beam.parameters import Numerics
from slider_jax.channels import BUILT_IN
from slider_jax.errors import InputError
from slider_jax.experiment.load import Experiment
from slider_jax.experiment.schema import FEWEST_NODES, Trial

WARM_UP = 2.0
"""[s] after which the body has forgotten that it started straight, and k and K_Q are near."""
SETTLE, SETTLE_ANEW = 0.3, 1.0
"""[s] not judged after a gap, bridged or not: three or four lags, and the body's memory."""
SHORT = 0.01
"""[s] of lost readings after which there is nothing to settle."""
DRIFT = 2.0
"""[s] over which the mean residual of forces and tip is followed: tares drift."""
CLOCK = 2e-3
"""[s] by which forces may be shifted against the manifold's readings. Both clocks are laid by what
arrives first, and on a busy computer that is later for one of them."""
PRIOR = 0.3
"""Standard deviation of k and K_Q before the stream, as a share."""
SYSTEMATIC_K, SYSTEMATIC_K_Q = 0.002, 0.005
"""Shares of k and K_Q that no stream tells: the sensors' gains (`calibration.inference.noise`),
the mesh."""
EXCITED = 10.0
"""Windows in which the model's pressures exceed their noise so many times tell of k and K_Q."""


@dataclass(frozen=True)
class TwinSettings:
    """How a twin runs. `rate` [Hz] of the readings; one `window` [s] is a value of the test.

    The mesh of the calibration (`calibration.model.predict.FINE`) would not keep up. Bands learn
    what a
    coarser one leaves under a regular drive, not what it leaves after an edge that came late: at
    the tip, of 60 mm, 0.2 mm for a second with 31 nodes and steps of two readings, 0.02 with these.
    """

    rate: float = 500.0
    samples: int = 10
    """Readings a block."""
    per_step: int = 1
    """Readings a step of the body."""
    nodes: int = 51
    tolerance: float = 1e-5
    window: float = 0.4
    learn: float = 6.0
    """[s] from which bands are learned; at least four strides are taken."""
    memory_k: float = 20.0
    """[s] over which k is forgotten."""
    memory_K_Q: float = 60.0


class TwinBlock(NamedTuple):
    """What the twin says of one block of readings."""

    t: np.ndarray
    """(samples,) [s], of the device's clock."""
    model: np.ndarray
    """(5, samples) in the order of `BUILT_IN`."""
    measured: np.ndarray
    """(5, samples), NaN where nothing was read."""
    lost: np.ndarray
    """(samples,) whether the reading was lost and bridged."""
    judged: np.ndarray
    """(samples,) whether the residual counts: not lost, nor just after a gap."""
    k: ParameterEstimate
    K_Q: ParameterEstimate
    alarm: Alarm
    watching: bool
    """Whether the bands are learned."""
    seconds: float
    """That the block took to compute."""

    @property
    def residual(self) -> np.ndarray:
        """(5, samples), measured minus model."""
        return self.measured - self.model


class Twin:
    """A model beside a stream. Made by `of`; the stream is given to `feed`."""

    def __init__(self, experiment: Experiment, settings: TwinSettings, trial: Trial):
        self.experiment, self.settings = experiment, settings
        robot = experiment.robot
        cells = split_cells(settings.nodes, robot.tail_length, robot.body_length)
        self.layout = BlockLayout(
            1.0 / settings.rate, settings.samples, settings.per_step,
            Numerics(*cells, tolerance=settings.tolerance),
        )  # fmt: skip
        self._load(trial)
        self._program = compiled(self._model, self.layout, self._rest)
        self.restart(forget=True)

    @classmethod
    def of(
        cls, experiment: Experiment, trial: Trial | int = 0, settings: TwinSettings = TwinSettings()
    ) -> "Twin":
        """Compile the model of a trial, whose coefficients and carriage it takes, and try it.

        Takes seconds. Raises `InputError` for settings that cannot be used.
        """
        if settings.samples < 2 or settings.per_step < 1 or settings.samples % settings.per_step:
            raise InputError.value(
                "twin settings, samples and per_step",
                f"{settings.samples} and {settings.per_step}",
                "a block of two readings or more, a whole number of steps",
            )
        if settings.nodes < FEWEST_NODES:
            allowed = f"{FEWEST_NODES} or more"
            raise InputError.value("twin settings, nodes", f"{settings.nodes}", allowed)
        trial = experiment.trials[trial] if isinstance(trial, int) else trial
        twin = cls(experiment, settings, trial)
        n = settings.samples
        still = Samples(twin.layout.period * np.arange(n), np.zeros((2, n)), np.zeros((5, n)))
        twin.feed(still)
        twin.restart(forget=True)
        return twin

    def begin(self, trial: Trial | int) -> None:
        """Go on with another trial's coefficients and carriage; k and K_Q stay. Not in a stream."""
        self._load(self.experiment.trials[trial] if isinstance(trial, int) else trial)
        self.restart()

    def restart(self, forget: bool = False) -> None:
        """Begin the stream anew, and learn its bands anew; k and K_Q stay unless `forget`."""
        if forget:
            self._k = self._recursive("k", self._values[0], self.settings.memory_k)
            self._K_Q = self._recursive("K_Q", self._values[1], self.settings.memory_K_Q)
        self._state = self._rest
        self.bridge = GapFiller(self.layout.period, self.layout.samples)
        self._past = np.zeros((2, PAST + 1))
        self._lost_in_a_row, self._settling = 0, 0
        self._parts: list[tuple] = []
        self._windows: list[Window] = []
        self._as_read: list[Window] = []
        self.misfits: dict[str, tuple[float, float]] = {}
        """Channels that did not fit while the bands were learned: rms of what was left, in SI, and
        its share of the model's. What is wrong by then is not judged."""
        self._means = 0
        self._tare = np.zeros(len(BUILT_IN))
        self._d_tare = np.zeros((len(VALUES), len(BUILT_IN)))
        self._watch: Watch | None = None

    def _recursive(self, name: str, value: float, memory: float) -> Recursive:
        low, high, windows = BASE[name].low, BASE[name].high, memory / self.settings.window
        return Recursive(float(value), PRIOR * float(value), low, high, windows)

    def _load(self, trial: Trial) -> None:
        experiment = self.experiment
        self._model, self._values = live_model(experiment, trial), values_of(experiment)
        self._rest = initial_block_state(self._model, self.layout, self._values)
        strides = 4.0 / trial.frequency if trial.frequency else 0.0
        count = max(self.settings.learn, strides) / self.settings.window
        self._learned_by = round(WARM_UP / self.settings.window), int(np.ceil(count))
        self._in_window = max(
            1, round(self.settings.window * self.settings.rate / self.layout.samples)
        )

    def feed(self, readings: Samples) -> list[TwinBlock]:
        """The blocks that these readings complete. Raises `InputError` for wrong shapes."""
        return [self._block(even) for even in self.bridge.add(readings)]

    def _block(self, even: UniformBlock) -> TwinBlock:
        began = time.perf_counter()
        model, along, faulty = self._predict(even)
        judged = self._judged(even)
        residual = np.where(judged, even.measured - model, np.nan)
        self._parts.append(Window(residual, even.measured, model, along, faulty))
        if len(self._parts) == self._in_window:
            self._close_window(float(even.t[-1]))
        alarm = self._watch.alarm if self._watch else NO_ALARM
        return TwinBlock(
            even.t, model, even.measured, even.lost, judged, self.k, self.K_Q, alarm,
            self._watch is not None, time.perf_counter() - began,
        )  # fmt: skip

    @property
    def judges_after(self) -> float:
        """[s] of a stream that is driven, until the bands are learned."""
        return sum(self._learned_by) * self.settings.window

    @property
    def k(self) -> ParameterEstimate:
        """The pressure lag [s] now."""
        return self._k.estimate.with_share(SYSTEMATIC_K)

    @property
    def K_Q(self) -> ParameterEstimate:
        """Moment per pressure [m^3] now."""
        return self._K_Q.estimate.with_share(SYSTEMATIC_K_Q)

    def _predict(self, even: UniformBlock) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """`Predicted` over a block; it begins anew at what is measured where the block does."""
        state = self._state
        if even.anew:
            self._past = np.repeat(even.set_pressure[:, :1], PAST + 1, axis=1)
            p = np.nan_to_num(even.measured[:2, 0])
            faulty = np.broadcast_to(p, state.faulty.shape).copy()
            begun: dict[str, Any] = {"p": p, "dp": np.zeros(2), "seen": p, "faulty": faulty}
            state = replace(state, **begun)
        set_pressure = np.concatenate([self._past, even.set_pressure], axis=1)
        self._past = set_pressure[:, -PAST - 1 :]
        values = np.array([self._k.value, self._K_Q.value, *self._values[2:]])
        t0 = np.asarray(even.t[0] - self.layout.period)
        state, predicted = self._program(
            self._model, state, values, t0, set_pressure, even.measured[:2]
        )
        if not state.body.ok:
            rest = self._rest
            state = replace(
                state, body=rest.body, d_body=rest.d_body, last=rest.last, d_last=rest.d_last
            )
            self._settle(SETTLE_ANEW)
        self._state = state
        channels, along, faulty = map(np.asarray, predicted)
        return channels, along, faulty

    def _settle(self, duration: float) -> None:
        self._settling = max(self._settling, round(duration / self.layout.period))

    def _judged(self, even: UniformBlock) -> np.ndarray:
        """(samples,) whether a sample counts."""
        if even.anew:
            self._settle(SETTLE_ANEW)
        found = np.zeros(len(even.t), bool)
        for i, lost in enumerate(even.lost):
            self._lost_in_a_row = self._lost_in_a_row + 1 if lost else 0
            if self._lost_in_a_row > SHORT / self.layout.period:
                self._settle(SETTLE)
            found[i] = not lost and self._settling == 0
            self._settling = max(self._settling - 1, 0) if not lost else self._settling
        return found

    def _close_window(self, t: float) -> None:
        """Learn from the window that is full, or judge it."""
        whole = Window(*(np.concatenate(x, axis=-1) for x in zip(*self._parts, strict=True)))
        window = _of_one_clock(self._about_mean(whole), self.layout.period)
        self._parts = []
        sensors, watch = self.experiment.sensors, self._watch
        bands = watch.bands if watch else Bands.declared(sensors, [*self._windows, window])
        driven = bool(np.any(window.size[:2] > EXCITED * bands.noise[:2]))
        inside = watch.inside(window) if watch else np.ones(len(BUILT_IN), bool)
        variance = bands.variance(window)
        if driven and inside[:2].all():
            self._k.update(*pull_of_lag(window, variance))
        if driven and inside.all():
            self._K_Q.update(*pull_of_moment(window, variance))
        if watch:
            watch.take(window, t)
        elif driven:
            self._windows.append(window)
            # A leak shows in the mean of a pressure; forces and tip have tares.
            pressures = whole.residual[:2]
            residual = np.concatenate([pressures, window.residual[2:]])
            self._as_read.append(window._replace(residual=residual))
            warm, learn = self._learned_by
            if len(self._windows) == warm + learn:
                self._watch = Watch(Bands.learned(sensors, self._windows[warm:]))
                self.misfits = misfits(self._as_read[warm:])

    def _about_mean(self, window: Window) -> Window:
        """Residual and derivatives without their means.

        Of forces and tip those of the last seconds; of the pressures, where a leak shows in the
        mean, those from before the alarm was on.
        """
        tare, d_tare = self._tare, self._d_tare
        there = np.isfinite(window.residual)
        share = there / np.maximum(there.sum(axis=1, keepdims=True), 1)
        mean = np.sum(share * np.where(there, window.residual, 0.0), axis=1)
        d_mean = np.sum(share * window.along, axis=2)
        self._means += 1
        gain = np.full(len(BUILT_IN), max(self.settings.window / DRIFT, 1.0 / self._means))
        gain[:2] = 0.0 if self._watch else 1.0 / self._means
        gain *= window.enough
        self._tare = tare + gain * (mean - tare)
        self._d_tare = d_tare + gain * (d_mean - d_tare)
        return window._replace(
            residual=window.residual - tare[:, None], along=window.along - d_tare[:, :, None]
        )


def _of_one_clock(window: Window, period: float) -> Window:
    """The window with its forces shifted by up to `CLOCK`, as fits it best, to the model's time.

    `along` is left what no shift could do as well.
    """
    forces = slice(2, 4)
    model, residual = window.model[forces], window.residual[forces]
    slope = np.gradient(model, period, axis=1)
    there = np.isfinite(residual)
    weighted = np.where(there, slope, 0.0) / np.maximum(np.mean(model**2, axis=1), 1e-300)[:, None]
    most = float(np.sum(weighted * slope))
    if not most > 0.0:
        return window
    shift = np.sum(weighted * np.where(there, residual, 0.0)) / most
    if abs(shift) > CLOCK:  # no clock's doing
        return window
    along, cleared = window.along.copy(), window.residual.copy()
    cleared[forces] -= shift * slope
    along[:, forces] -= (
        np.sum(weighted * along[:, forces], axis=(1, 2))[:, None, None] / most * slope
    )
    return window._replace(residual=cleared, along=along)
