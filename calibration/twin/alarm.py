"""Tests whether live readings still fit the model: bands, a sequential test and a probable cause.

For each channel and window of readings, the test computes log(mean square of residual / band^2):

    band^2 = noise^2 + (share S)^2

S is the rms of the predicted reading in this window, or in the first windows if larger. `share` is
the declared relative error of the model, or a larger value that is learned from the first windows.
The logarithm is standardised with its mean and standard deviation in the first windows. A positive
value counts only if the residual is outside the band. A one-sided cumulative sum (CUSUM) adds one
value per window. Source: Page, E. S. (1954), Continuous inspection schemes, Biometrika 41, 100-115.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from calibration.inference.noise import channel_noise, signal_shares
from calibration.twin.block import FAULT_HYPOTHESES
from slider_jax.channels import Channel, ChannelSet
from slider_jax.experiment.actuator_tables import ChamberTable
from slider_jax.experiment.sensor_tables import SensorsTable

REFERENCE, THRESHOLD = 2.0, 6.0
"""Reference value and threshold of the CUSUM, in standard deviations (see `run_length`)."""
MAX_DEVIATION = 5.0
"""A larger deviation of a window counts as this value, so that an alarm needs three windows."""
MIN_SPREAD = 0.25
"""This value replaces a smaller standard deviation of the logarithm. An estimate from few windows
may be too small."""
MAX_LEARNED_SHARE = {"pressure": 0.1, "thrust": 0.4, "recoil": 0.4, "tip": 0.2}
"""Largest learned `share` of each sensor. A larger residual indicates a wrong model."""
MAX_MISFIT = {"pressure": 0.04, "thrust": 0.25, "recoil": 0.12, "tip": 0.12}
"""If the relative residual (rms/S) of a channel in the first windows exceeds this value, a misfit
is reported. With a calibrated model, the relative residual is 0.01 for the pressures, 0.15 for
thrust, 0.05 for recoil and tip. With a leak of a fifth of a valve's flow, it is 0.09 for the
pressure."""
MIN_SAMPLES = 10
"""A channel is not tested in a window with fewer readings."""
MIN_NOISE = 1e-9
"""Smallest noise of a channel, divided by S. A simulated stream may have no noise."""
EVIDENCE_RETENTION = 0.5
"""Factor by which each new window multiplies the evidence of earlier windows for a cause."""
MIN_EXPLAINED = 0.4
"""A cause is named if it explains at least this fraction of the residual's mean square."""


def sensor_of(channel: Channel) -> str:
    """Returns the key of a channel in `MAX_LEARNED_SHARE` and `MAX_MISFIT`."""
    return "pressure" if channel.kind == "pressure" else channel.name


def run_length(reference: float, threshold: float, shift: float = 0.0) -> float:
    """Returns the mean number of windows until an alarm, for independent values N(`shift`, 1).

    Source: Siegmund, D. (1985), Sequential Analysis, eq. 2.56.
    """
    drift, height = shift - reference, threshold + 1.166
    if drift == 0.0:
        return height**2
    return (math.exp(-2.0 * drift * height) - 1.0 + 2.0 * drift * height) / (2.0 * drift**2)


class Window(NamedTuple):
    """The data of some consecutive blocks, with the channels of `block.live_channels`."""

    residual: np.ndarray
    """Measured minus predicted readings (channels, n). A residual that is not tested is NaN."""
    measured: np.ndarray
    """Measured readings (channels, n)."""
    model: np.ndarray
    """Predicted readings (channels, n)."""
    derivatives: np.ndarray
    """Derivatives (parameters, channels, n) of `model` with respect to `block.PARAMETERS`."""
    faulty: np.ndarray
    """Pressures (faults, actuators, n) [Pa] with each of `FAULT_HYPOTHESES`."""

    @property
    def pressures(self) -> int:
        """Number of pressures, which are the first channels."""
        return self.faulty.shape[1]

    @property
    def size(self) -> np.ndarray:
        """rms S of the predicted readings, (channels,)."""
        return np.sqrt(np.mean(self.model**2, axis=1))

    @property
    def sufficient(self) -> np.ndarray:
        """Whether a channel has enough samples for the test, (channels,)."""
        return np.sum(np.isfinite(self.residual), axis=1) >= MIN_SAMPLES

    @property
    def mean_square(self) -> np.ndarray:
        """Mean square of the residual, (channels,); NaN for fewer than `MIN_SAMPLES` readings."""
        finite = np.isfinite(self.residual)
        total = np.sum(np.where(finite, self.residual, 0.0) ** 2, axis=1)
        return np.where(self.sufficient, total / np.maximum(finite.sum(axis=1), 1), np.nan)


def channel_misfits(channels: ChannelSet, windows: list[Window]) -> dict[str, tuple[float, float]]:
    """Returns rms of the residual, and rms/S, for channels whose rms/S exceeds `MAX_MISFIT`."""
    squares = np.array([w.mean_square for w in windows])
    sizes = np.array([w.size**2 for w in windows])
    found = {}
    for i, channel in enumerate(channels.values()):
        if np.isfinite(squares[:, i]).any():
            rms = math.sqrt(np.nanmean(squares[:, i]))
            share = rms / max(math.sqrt(sizes[:, i].mean()), 1e-300)
            if share > MAX_MISFIT[sensor_of(channel)]:
                found[channel.name] = (rms, share)
    return found


@dataclass
class Bands:
    """Bands of all channels, (channels,): `noise` in the channel's unit, and `share` (no unit).

    S is at least `reference_size`, the rms of the predicted readings in the first windows. If the
    stroke decreases, a constant residual, such as a sensor's offset, thus stays within the band.
    """

    noise: np.ndarray
    share: np.ndarray
    reference_size: np.ndarray
    mean: np.ndarray = field(default_factory=lambda: np.zeros(()))
    """Mean (channels,) of the logarithm over windows without a fault."""
    spread: np.ndarray = field(default_factory=lambda: np.array(MIN_SPREAD))
    """Standard deviation (channels,) of the logarithm over windows without a fault."""

    def __post_init__(self) -> None:
        self.mean = np.full(self.noise.shape, self.mean)
        self.spread = np.full(self.noise.shape, self.spread)

    @classmethod
    def declared(
        cls, sensors: SensorsTable, channels: ChannelSet, windows: list[Window]
    ) -> "Bands":
        """Returns bands for the declared noise. White noise that is not declared is estimated."""
        values = np.concatenate([w.measured for w in windows], axis=1)
        size = np.sqrt(np.mean([w.size**2 for w in windows], axis=0))
        noise = MIN_NOISE * np.maximum(size, 1e-12)
        for i, channel in enumerate(channels.values()):
            if np.isfinite(values[i]).sum() >= MIN_SAMPLES:
                sensor = channel_noise(sensors, channel, values[i])
                noise[i] = max(noise[i], math.hypot(sensor.white, sensor.slow))
        shares = [signal_shares(sensors, x) for x in channels.values()]
        share = np.array([math.hypot(*x) for x in shares])
        return cls(noise, share, size)

    @classmethod
    def learned(cls, sensors: SensorsTable, channels: ChannelSet, windows: list[Window]) -> "Bands":
        """Returns the declared bands, widened to the residuals of the given windows."""
        bands = cls.declared(sensors, channels, windows)
        largest = [MAX_LEARNED_SHARE[sensor_of(x)] for x in channels.values()]
        squares = np.array([w.mean_square for w in windows])
        sizes = np.array([w.size**2 for w in windows])
        for i in np.flatnonzero(np.isfinite(squares).sum(axis=0) >= 3):
            finite = np.isfinite(squares[:, i])
            mean_square, S2 = squares[finite, i].mean(), sizes[finite, i].mean()
            share = math.sqrt(max(mean_square - bands.noise[i] ** 2, 0.0) / max(S2, 1e-300))
            bands.share[i] = max(bands.share[i], min(share, largest[i]))
        logs = np.array([bands.logarithm(w) for w in windows])
        for i in np.flatnonzero(np.isfinite(logs).sum(axis=0) >= 3):
            x = logs[np.isfinite(logs[:, i]), i]
            bands.mean[i] = min(x.mean(), 0.0)
            bands.spread[i] = max(x.std(ddof=1), MIN_SPREAD)
        return bands

    def variance(self, window: Window) -> np.ndarray:
        """Returns the squared band of each channel in a window, (channels,)."""
        return self.noise**2 + (self.share * np.maximum(window.size, self.reference_size)) ** 2

    def deviation(self, window: Window) -> np.ndarray:
        """Returns the standardised logarithm (channels,) of a window; NaN for an untested channel.

        Within the band, the result is at most 0. A residual that was much smaller than the band in
        the first windows may therefore increase up to the band without an alarm.
        """
        logarithm = self.logarithm(window)
        standardised = (logarithm - self.mean) / self.spread
        return np.where(logarithm > 0.0, standardised, np.minimum(standardised, 0.0))

    def logarithm(self, window: Window) -> np.ndarray:
        """Returns log(mean square / band^2), (channels,); NaN for an untested channel."""
        return np.log(np.maximum(window.mean_square, 1e-300) / self.variance(window))


class Alarm(NamedTuple):
    """State of the test after a window."""

    on: bool
    channels: tuple[str, ...]
    """Names of the channels outside their bands."""
    hint: str
    """Probable cause of the alarm in words; empty if there is no alarm."""


NO_ALARM = Alarm(False, (), "")


class SequentialTest:
    """The sequential test of all channels, with the evidence for each possible cause of an alarm.

    A CUSUM is limited to twice the threshold, so that an alarm ends soon after the fault ends.
    """

    def __init__(self, bands: Bands, channels: ChannelSet, chambers: Sequence[ChamberTable]):
        self.bands, self._channels, self._chambers = bands, channels, chambers
        self.cusum = np.zeros(len(channels))
        self.alarm = NO_ALARM
        self._pressures = np.zeros((3, len(FAULT_HYPOTHESES), len(chambers)))
        self._body, self._pull, self._normal = 0.0, np.zeros(3), np.zeros((3, 3))

    def inside(self, window: Window) -> np.ndarray:
        """Returns whether the CUSUM of each channel remains zero with this window, (channels,)."""
        deviation = np.nan_to_num(self.bands.deviation(window), nan=0.0)
        return (self.cusum + deviation - REFERENCE) <= 0.0

    def update(self, window: Window) -> None:
        """Adds a window and updates the alarm."""
        deviation = np.nan_to_num(self.bands.deviation(window), nan=REFERENCE)
        change = np.minimum(deviation, MAX_DEVIATION) - REFERENCE
        self.cusum = np.clip(self.cusum + change, 0.0, 2.0 * THRESHOLD)
        self._add_evidence(window)
        before = self.alarm
        on = self.cusum > (0.0 if before.on else THRESHOLD)
        if not on.any():
            self.alarm = NO_ALARM
            return
        channels = tuple(c for c, x in zip(self._channels, on, strict=True) if x)
        # After the cause has ended, new windows contain no evidence for the cause.
        active = bool(np.any(deviation > REFERENCE)) or not before.on
        self.alarm = Alarm(True, channels, self._hint(on) if active else before.hint)

    def _add_evidence(self, window: Window) -> None:
        """Adds a window to the sums for least-squares fits of faults and parameters."""
        variance, m = self.bands.variance(window)[:, None], window.pressures
        finite = np.isfinite(window.residual)
        r = np.where(finite, window.residual, 0.0) / np.sqrt(variance)
        d = np.where(finite[:m], window.faulty - window.model[:m], 0.0) / np.sqrt(variance[:m])
        rr = np.broadcast_to(np.sum(r[:m] ** 2, axis=1), d.shape[:2])
        sums = (rr, np.sum(r[:m] * d, axis=2), np.sum(d**2, axis=2))
        self._pressures = EVIDENCE_RETENTION * self._pressures + np.stack(sums)
        J = np.where(finite[m:], window.derivatives[1:, m:], 0.0) / np.sqrt(variance[m:])
        J = J.reshape(len(J), -1)
        self._normal = EVIDENCE_RETENTION * self._normal + J @ J.T
        self._pull = EVIDENCE_RETENTION * self._pull + J @ r[m:].ravel()
        self._body = EVIDENCE_RETENTION * self._body + np.sum(r[m:] ** 2)

    def _hint(self, on: np.ndarray) -> str:
        pressures = on[: len(self._chambers)]
        if pressures.any():
            return "; ".join(self._chamber(int(i)) for i in np.flatnonzero(pressures))
        channels = ", ".join(c for c, x in zip(self._channels, on, strict=True) if x)
        # The stiffness and the length of a tail may change, so they are fitted together.
        tail, K_Q = self._explained([1, 2]), self._explained([0])
        if max(K_Q, tail) < MIN_EXPLAINED:
            return f"body, tail or sensors of {channels}; the pressures fit the model"
        cause = "changed tail" if tail > K_Q else "changed moment per pressure (K_Q)"
        return f"{cause}: the pressures fit the model, but {channels} do not"

    def _explained(self, which: list[int]) -> float:
        """Returns the fraction by which new values of `PARAMETERS[1:]` with the indices `which`
        reduce the mean square of the residuals of thrust, recoil and tip."""
        A, b = self._normal[np.ix_(which, which)], self._pull[which]
        size = np.sqrt(np.maximum(np.diag(A), 1e-300))
        x = np.linalg.lstsq(A / np.outer(size, size), b / size, rcond=1e-6)[0]
        return float(x @ (b / size)) / max(self._body, 1e-300)

    def _chamber(self, i: int) -> str:
        rr, rd, dd = self._pressures[:, :, i]
        size = np.maximum(rd, 0.0) / np.maximum(dd, 1e-300)
        gained = size * rd / np.maximum(rr, 1e-300)
        best = int(np.argmax(gained))
        where, pair = self._chambers[i].name, self._chambers[i].side == "both"
        all_sides = " chambers" if pair else ""
        if gained[best] < MIN_EXPLAINED:
            return (
                f"{where}{all_sides}: unknown fault (not a leak, a blocked valve or a slower lag)"
            )
        hypothesis = FAULT_HYPOTHESES[best]
        side = {1: "_left", -1: "_right", 0: all_sides}[hypothesis.side] if pair else ""
        return f"{hypothesis.cause}: {where}{side}"
