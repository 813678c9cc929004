"""The live twin: a calibrated model that runs in parallel with a stream of readings.

    twin = Twin.of(experiment)                 # call this before the stream: it compiles the model
    for block in twin.feed(readings):          # call this whenever readings arrive
        block.model, block.residual, block.k, block.K_Q, block.alarm

After `WARM_UP`, the twin learns the bands (the normal ranges of the residuals) for `learn` seconds.
After this time, the twin tests each window of readings. While no residual exceeds its band, the
twin also updates k and K_Q.
"""

import time
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calibration.model.extended import BASE
from calibration.twin.alarm import NO_ALARM, Alarm, Bands, SequentialTest, Window, channel_misfits
from calibration.twin.block import (
    HISTORY,
    PARAMETERS,
    BlockLayout,
    compile_block,
    initial_block_state,
    live_channels,
    live_model,
    parameter_values,
    pressure_state,
)
from calibration.twin.estimate import (
    ParameterEstimate,
    RecursiveEstimator,
    lag_gradient,
    moment_gradient,
)
from calibration.twin.stream import GapFiller, Samples, UniformBlock
from slider_jax.beam.grid import split_cells
from slider_jax.beam.parameters import Numerics
from slider_jax.effects import Command, of_place
from slider_jax.errors import InputError
from slider_jax.experiment.load import Experiment
from slider_jax.experiment.schema import FEWEST_NODES, Trial
from slider_jax.realtime.causality import check_commands

WARM_UP = 2.0
"""Time [s] until the initial shape has no influence, and k and K_Q are nearly correct."""
SETTLING, SETTLING_AFTER_RESTART = 0.3, 1.0
"""Times [s] without a test: after a filled gap (3 to 4 time constants k), and after a restart."""
NEGLIGIBLE_GAP = 0.01
"""Lost readings for up to this duration [s] need no settling time."""
TARE_TIME = 2.0
"""Time constant [s] of the running mean of force and tip residuals, an estimate of the tares."""
MAX_CLOCK_SHIFT = 2e-3
"""Largest expected shift [s] between the clocks of force sensor and manifold. The host aligns the
clocks by the earliest arrival of data. On a busy computer, even the earliest data may be late."""
INITIAL_DEVIATION = 0.3
"""Relative standard deviation of k and K_Q before the stream."""
SYSTEMATIC_K, SYSTEMATIC_K_Q = 0.002, 0.005
"""Relative errors of k and K_Q from sensor gains and mesh. More data do not reduce these errors."""
MIN_EXCITATION = 10.0
"""A window updates k and K_Q if the rms pressure exceeds this multiple of the pressure noise."""


@dataclass(frozen=True)
class TwinSettings:
    """Settings of a twin.

    The calibration's mesh (`calibration.model.plan.FINE`) is too slow for real time. The learned
    bands include the error of the coarser mesh, but not its error after an irregular change of the
    set pressure. For a tip amplitude of 60 mm, the error of the tip after such a change is 0.02 mm
    with these settings, and 0.2 mm for 1 s with 31 nodes and time steps of two readings.
    """

    rate: float = 500.0
    """Rate of the readings [Hz]."""
    samples: int = 10
    """Readings per block."""
    per_step: int = 1
    """Readings per time step of the body."""
    nodes: int = 51
    tolerance: float = 1e-5
    window: float = 0.4
    """Duration [s] of a window. The sequential test has one value per window."""
    learn: float = 6.0
    """Duration [s] in which the bands are learned (at least four strides)."""
    memory_k: float = 20.0
    """Time constant [s] of the decreasing weight of older windows in the estimate of k."""
    memory_K_Q: float = 60.0
    """Time constant [s] of the decreasing weight of older windows in the estimate of K_Q."""


class TwinBlock(NamedTuple):
    """The twin's result for one block of readings."""

    t: np.ndarray
    """Times (samples,) [s] on the device's clock."""
    model: np.ndarray
    """Predicted readings (channels, samples) in the order of `Twin.channels`."""
    measured: np.ndarray
    """Measured readings (channels, samples). A missing reading is NaN."""
    lost: np.ndarray
    """Whether the reading was lost, (samples,)."""
    valid: np.ndarray
    """Whether the residual is tested, (samples,). Residuals shortly after a gap are not tested."""
    k: ParameterEstimate
    K_Q: ParameterEstimate
    alarm: Alarm
    watching: bool
    """Whether the twin has learned the bands and tests the windows."""
    seconds: float
    """Computing time of the block [s]."""

    @property
    def residual(self) -> np.ndarray:
        """Measured minus predicted readings, (channels, samples)."""
        return self.measured - self.model


class Twin:
    """A model that runs in parallel with a stream of readings. `Twin.of` creates a twin."""

    def __init__(self, experiment: Experiment, settings: TwinSettings, trial: Trial):
        self.experiment, self.settings = experiment, settings
        self.channels = live_channels(experiment)
        self._actuators = len(experiment.chambers)
        robot = experiment.robot
        cells = split_cells(settings.nodes, *robot.lengths)
        self.layout = BlockLayout(
            1.0 / settings.rate, settings.samples, settings.per_step,
            Numerics(*cells, tolerance=settings.tolerance),
        )  # fmt: skip
        self._model, self._values = live_model(experiment, trial), parameter_values(experiment)
        check_commands(of_place(self._model.effects, Command), self.layout.period, HISTORY)
        self._rest = initial_block_state(self._model, self.layout, self._values)
        strides = 4.0 / trial.frequency if trial.frequency else 0.0
        count = max(settings.learn, strides) / settings.window
        self._learned_by = round(WARM_UP / settings.window), int(np.ceil(count))
        self._in_window = max(1, round(settings.window * settings.rate / settings.samples))
        self._program = compile_block(self._model, self.layout, self._rest)
        self.restart()

    @classmethod
    def of(
        cls, experiment: Experiment, trial: Trial | int = 0, settings: TwinSettings = TwinSettings()
    ) -> "Twin":
        """Returns a compiled twin with the C_d, m_a and tow speed of `trial` (index or trial).

        The call takes some seconds. Raises `InputError` for invalid settings, and for effects of
        the valves that depend on future set pressures or on old ones.
        """
        if settings.samples < 2 or settings.per_step < 1 or settings.samples % settings.per_step:
            raise InputError.value(
                "twin settings, samples and per_step",
                f"{settings.samples} and {settings.per_step}",
                "2 or more samples, and samples must be a multiple of per_step",
            )
        if settings.nodes < FEWEST_NODES:
            allowed = f"{FEWEST_NODES} or more"
            raise InputError.value("twin settings, nodes", f"{settings.nodes}", allowed)
        trial = experiment.trials[trial] if isinstance(trial, int) else trial
        twin, n = cls(experiment, settings, trial), settings.samples
        rest = np.zeros((twin._actuators, n)), np.zeros((len(twin.channels), n))
        twin.feed(Samples(twin.layout.period * np.arange(n), *rest))
        twin.restart()
        return twin

    def restart(self) -> None:
        """Discards the learned bands and the estimates of k and K_Q, for a new stream."""
        self._k = self._recursive("k", self._values[0], self.settings.memory_k)
        self._K_Q = self._recursive("K_Q", self._values[1], self.settings.memory_K_Q)
        self._state = self._rest
        self.gap_filler = GapFiller(self.layout.period, self.layout.samples, self._actuators)
        self._past = np.zeros((self._actuators, HISTORY + 1))
        self._lost_in_a_row, self._settling = 0, 0
        self._parts: list[tuple] = []
        self._windows: list[Window] = []
        self._raw_windows: list[Window] = []
        self.misfits: dict[str, tuple[float, float]] = {}
        """Channels with too large residuals while the bands were learned: rms of the residual in SI
        units, and rms divided by S. The learned bands include them, so they cause no alarm."""
        self._means = 0
        self._tare = np.zeros(len(self.channels))
        self._d_tare = np.zeros((len(PARAMETERS), len(self.channels)))
        self._test: SequentialTest | None = None

    def _recursive(self, name: str, value: float, memory: float) -> RecursiveEstimator:
        low, high, windows = BASE[name].low, BASE[name].high, memory / self.settings.window
        return RecursiveEstimator(
            float(value), INITIAL_DEVIATION * float(value), low, high, windows
        )

    def feed(self, readings: Samples) -> list[TwinBlock]:
        """Returns the blocks that these readings complete. Raises `InputError` for wrong shapes."""
        return [self._block(block) for block in self.gap_filler.add(readings)]

    def _block(self, block: UniformBlock) -> TwinBlock:
        start = time.perf_counter()
        model, derivatives, faulty = self._predict(block)
        valid = self._valid(block)
        residual = np.where(valid, block.measured - model, np.nan)
        self._parts.append(Window(residual, block.measured, model, derivatives, faulty))
        if len(self._parts) == self._in_window:
            self._close_window()
        alarm = self._test.alarm if self._test else NO_ALARM
        return TwinBlock(
            block.t, model, block.measured, block.lost, valid, self.k, self.K_Q, alarm,
            self._test is not None, time.perf_counter() - start,
        )  # fmt: skip

    @property
    def judges_after(self) -> float:
        """Duration [s] of a driven stream after which the twin has learned the bands."""
        return sum(self._learned_by) * self.settings.window

    @property
    def k(self) -> ParameterEstimate:
        """Current estimate of the lag's time constant [s]."""
        return self._k.estimate.with_share(SYSTEMATIC_K)

    @property
    def K_Q(self) -> ParameterEstimate:
        """Current estimate of the moment per pressure [m^3]."""
        return self._K_Q.estimate.with_share(SYSTEMATIC_K_Q)

    def _predict(self, block: UniformBlock) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns the fields of `BlockPrediction`. A restart sets p to the measured pressure."""
        state = self._state
        if block.restarted:
            self._past = np.repeat(block.set_pressure[:, :1], HISTORY + 1, axis=1)
            p = np.nan_to_num(block.measured[: self._actuators, 0])
            state = replace(state, **pressure_state(self._model, p))
        set_pressure = np.concatenate([self._past, block.set_pressure], axis=1)
        self._past = set_pressure[:, -HISTORY - 1 :]
        values = np.array([self._k.value, self._K_Q.value, *self._values[2:]])
        t0 = np.asarray(block.t[0] - self.layout.period)
        state, predicted = self._program(
            self._model, state, values, t0, set_pressure, block.measured[: self._actuators]
        )
        if not state.body.ok:
            rest = self._rest
            state = replace(
                state, body=rest.body, d_body=rest.d_body, last=rest.last, d_last=rest.d_last
            )
            self._settle(SETTLING_AFTER_RESTART)
        self._state = state
        channels, derivatives, faulty = map(np.asarray, predicted)
        return channels, derivatives, faulty

    def _settle(self, duration: float) -> None:
        self._settling = max(self._settling, round(duration / self.layout.period))

    def _valid(self, block: UniformBlock) -> np.ndarray:
        """Returns whether each sample is tested, (samples,)."""
        if block.restarted:
            self._settle(SETTLING_AFTER_RESTART)
        valid = np.zeros(len(block.t), bool)
        for i, lost in enumerate(block.lost):
            self._lost_in_a_row = self._lost_in_a_row + 1 if lost else 0
            if self._lost_in_a_row > NEGLIGIBLE_GAP / self.layout.period:
                self._settle(SETTLING)
            valid[i] = not lost and self._settling == 0
            self._settling = max(self._settling - 1, 0) if not lost else self._settling
        return valid

    def _close_window(self) -> None:
        """Updates k and K_Q with the complete window, and tests the window or learns the bands."""
        whole = Window(*(np.concatenate(x, axis=-1) for x in zip(*self._parts, strict=True)))
        window = _aligned_forces(self._without_mean(whole), self.layout.period)
        self._parts = []
        sensors, test, m = self.experiment.sensors, self._test, self._actuators
        before = [*self._windows, window]
        bands = test.bands if test else Bands.declared(sensors, self.channels, before)
        driven = bool(np.any(window.size[:m] > MIN_EXCITATION * bands.noise[:m]))
        inside = test.inside(window) if test else np.ones(len(self.channels), bool)
        variance = bands.variance(window)
        if driven and inside[:m].all():
            self._k.update(*lag_gradient(window, variance))
        if driven and inside.all():
            self._K_Q.update(*moment_gradient(window, variance))
        if test:
            test.update(window)
        elif driven:
            self._windows.append(window)
            # A leak changes the mean pressure, so the residuals of the pressures keep their means.
            pressures = whole.residual[:m]
            residual = np.concatenate([pressures, window.residual[m:]])
            self._raw_windows.append(window._replace(residual=residual))
            warm, learn = self._learned_by
            if len(self._windows) == warm + learn:
                bands = Bands.learned(sensors, self.channels, self._windows[warm:])
                self._test = SequentialTest(bands, self.channels, self.experiment.chambers)
                self.misfits = channel_misfits(self.channels, self._raw_windows[warm:])

    def _without_mean(self, window: Window) -> Window:
        """Returns the window minus the means of residual and derivatives.

        The means of forces and tip are running means over `TARE_TIME`. The means of the pressures
        stay constant after the bands are learned, because a leak changes the mean pressure.
        """
        tare, d_tare = self._tare, self._d_tare
        finite = np.isfinite(window.residual)
        share = finite / np.maximum(finite.sum(axis=1, keepdims=True), 1)
        mean = np.sum(share * np.where(finite, window.residual, 0.0), axis=1)
        d_mean = np.sum(share * window.derivatives, axis=2)
        self._means += 1
        gain = np.full(len(self.channels), max(self.settings.window / TARE_TIME, 1.0 / self._means))
        gain[: self._actuators] = 0.0 if self._test else 1.0 / self._means
        gain *= window.sufficient
        self._tare = tare + gain * (mean - tare)
        self._d_tare = d_tare + gain * (d_mean - d_tare)
        return window._replace(
            residual=window.residual - tare[:, None],
            derivatives=window.derivatives - d_tare[:, :, None],
        )


def _aligned_forces(window: Window, period: float) -> Window:
    """Returns the window with the measured forces shifted in time to fit the model best.

    A shift above `MAX_CLOCK_SHIFT` is not applied. The shift is also removed from `derivatives`.
    """
    forces = slice(window.pressures, window.pressures + 2)  # thrust and recoil
    model, residual = window.model[forces], window.residual[forces]
    slope = np.gradient(model, period, axis=1)
    finite = np.isfinite(residual)
    weighted = np.where(finite, slope, 0.0) / np.maximum(np.mean(model**2, axis=1), 1e-300)[:, None]
    total = float(np.sum(weighted * slope))
    if not total > 0.0:
        return window
    shift = np.sum(weighted * np.where(finite, residual, 0.0)) / total
    if abs(shift) > MAX_CLOCK_SHIFT:  # too large for a clock error
        return window
    derivatives, cleared = window.derivatives.copy(), window.residual.copy()
    cleared[forces] -= shift * slope
    derivatives[:, forces] -= (
        np.sum(weighted * derivatives[:, forces], axis=(1, 2))[:, None, None] / total * slope
    )
    return window._replace(residual=cleared, derivatives=derivatives)
