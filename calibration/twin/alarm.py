"""Whether a live stream still fits its model: bands, a sequential test, and a hint at the cause.

A window's residual of a channel is judged by the logarithm of its mean square over

    band^2 = noise^2 + (share S)^2

with S the rms of the model in that window or, if larger, in the first ones. Noise and share are
what is declared, or what the first windows show where that is more. The logarithms, in deviations
about their mean in those windows, and above 0 outside the band only, go to a one-sided CUSUM
(Page, E. S. (1954), Continuous inspection schemes, Biometrika 41, 100-115). A window counts as one
value however its samples are correlated.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from calibration.inference.noise import channel_noise
from calibration.twin.faults import SUSPECTS
from slider_jax.channels import BUILT_IN, CHANNELS
from slider_jax.experiment.schema import SensorsTable

REFERENCE, THRESHOLD = 2.0, 6.0
"""Of the CUSUM, in deviations: see `run_length`."""
MOST = 5.0
"""A window counts for no more: two at least make an alarm."""
LEAST_SPREAD = 0.25
"""Deviation of a window's logarithm is taken to be at least this: a dozen windows may show less."""
WORST = (0.1, 0.1, 0.4, 0.4, 0.2)
"""Largest share that the first windows may teach, by channel: a model that leaves more is wrong."""
MISFIT = (0.04, 0.04, 0.25, 0.12, 0.12)
"""Share of a channel that the first windows may leave untold. A calibrated model leaves 0.01 of the
pressures, 0.15 of thrust and 0.05 of recoil and tip; a leak of a fifth of a valve's flow 0.09."""
FEW = 10
"""A channel with fewer samples in a window is not judged by it."""
SMALL = 1e-9
"""Least noise, relative to the channel's S: that of a noise-free stream."""
KEPT = 0.5
"""Share of the evidence for a cause that is kept from window to window."""
FITS = 0.4
"""A cause is named if it explains so much of the residual's mean square."""


def run_length(reference: float, threshold: float, shift: float = 0.0) -> float:
    """Mean windows to an alarm of a CUSUM of independent normal values with mean `shift`.

    Source: Siegmund, D. (1985), Sequential Analysis, eq. 2.56.
    """
    drift, height = shift - reference, threshold + 1.166
    if drift == 0.0:
        return height**2
    return (math.exp(-2.0 * drift * height) - 1.0 + 2.0 * drift * height) / (2.0 * drift**2)


class Window(NamedTuple):
    """What was gathered of some blocks; residuals are NaN where they are not to be judged."""

    residual: np.ndarray
    """(5, n)"""
    measured: np.ndarray
    """(5, n)"""
    model: np.ndarray
    """(5, n)"""
    along: np.ndarray
    """(4, 5, n), the model's derivatives to `VALUES`."""
    faulty: np.ndarray
    """(suspects, 2, n) [Pa]"""

    @property
    def size(self) -> np.ndarray:
        """S (5,): rms of the model."""
        return np.sqrt(np.mean(self.model**2, axis=1))

    @property
    def enough(self) -> np.ndarray:
        """(5,) whether there are samples to judge a channel by."""
        return np.sum(np.isfinite(self.residual), axis=1) >= FEW

    @property
    def mean_square(self) -> np.ndarray:
        """Of the residual (5,); NaN without samples enough."""
        there = np.isfinite(self.residual)
        total = np.sum(np.where(there, self.residual, 0.0) ** 2, axis=1)
        return np.where(self.enough, total / np.maximum(there.sum(axis=1), 1), np.nan)


def misfits(windows: list[Window]) -> dict[str, tuple[float, float]]:
    """Channels of which windows leave more than `MISFIT`: rms of that, and its share of S."""
    squares = np.array([w.mean_square for w in windows])
    sizes = np.array([w.size**2 for w in windows])
    found = {}
    for i, channel in enumerate(BUILT_IN):
        if np.isfinite(squares[:, i]).any():
            rms = math.sqrt(np.nanmean(squares[:, i]))
            share = rms / max(math.sqrt(sizes[:, i].mean()), 1e-300)
            if share > MISFIT[i]:
                found[channel] = (rms, share)
    return found


@dataclass
class Bands:
    """Band of each channel: `noise` in its unit, `share` of S; all (5,).

    It does not shrink below that of `least`, the S at which it was found: what is left there, as of
    a sensor's offset, may be left of a smaller stroke too.
    """

    noise: np.ndarray
    share: np.ndarray
    least: np.ndarray
    mean: np.ndarray = field(default_factory=lambda: np.zeros(5))
    """Of a window's logarithm, where all is well."""
    spread: np.ndarray = field(default_factory=lambda: np.full(5, LEAST_SPREAD))
    """Its deviation."""

    @classmethod
    def declared(cls, sensors: SensorsTable, windows: list[Window]) -> "Bands":
        """What sensors declare; the white noise is measured where they do not."""
        values = np.concatenate([w.measured for w in windows], axis=1)
        size = np.sqrt(np.mean([w.size**2 for w in windows], axis=0))
        noise = SMALL * np.maximum(size, 1e-12)
        for i, channel in enumerate(BUILT_IN):
            if np.isfinite(values[i]).sum() >= FEW:
                found = channel_noise(sensors, channel, values[i])
                noise[i] = max(noise[i], math.hypot(found.white, found.slow))
        share = np.array([math.hypot(CHANNELS[c].gain, CHANNELS[c].discrepancy) for c in BUILT_IN])
        return cls(noise, share, size)

    @classmethod
    def learned(cls, sensors: SensorsTable, windows: list[Window]) -> "Bands":
        """The declared bands, widened to what the windows show."""
        bands = cls.declared(sensors, windows)
        squares = np.array([w.mean_square for w in windows])
        sizes = np.array([w.size**2 for w in windows])
        for i in np.flatnonzero(np.isfinite(squares).sum(axis=0) >= 3):
            there = np.isfinite(squares[:, i])
            seen, S2 = squares[there, i].mean(), sizes[there, i].mean()
            more = math.sqrt(max(seen - bands.noise[i] ** 2, 0.0) / max(S2, 1e-300))
            bands.share[i] = max(bands.share[i], min(more, WORST[i]))
        logs = np.array([bands.logarithm(w) for w in windows])
        for i in np.flatnonzero(np.isfinite(logs).sum(axis=0) >= 3):
            x = logs[np.isfinite(logs[:, i]), i]
            bands.mean[i] = min(x.mean(), 0.0)
            bands.spread[i] = max(x.std(ddof=1), LEAST_SPREAD)
        return bands

    def variance(self, window: Window) -> np.ndarray:
        """band^2 (5,)."""
        return self.noise**2 + (self.share * np.maximum(window.size, self.least)) ** 2

    def deviation(self, window: Window) -> np.ndarray:
        """Deviations by which a window lies above what is usual (5,); NaN where it is not judged.

        At most 0 where it lies in the band: a stream that leaves no more than sensors and model may
        is sound, also where it has left still less before.
        """
        over = self.logarithm(window)
        usual = (over - self.mean) / self.spread
        return np.where(over > 0.0, usual, np.minimum(usual, 0.0))

    def logarithm(self, window: Window) -> np.ndarray:
        """Of the residual's mean square over band^2 (5,); NaN where a window is not judged."""
        return np.log(np.maximum(window.mean_square, 1e-300) / self.variance(window))


class Alarm(NamedTuple):
    """State of the test after a window."""

    on: bool
    since: float
    """[s], when it came on; NaN if it is off."""
    channels: tuple[str, ...]
    """Those that have left their band."""
    hint: str
    """What may have caused it, in words."""
    score: np.ndarray
    """The CUSUMs (5,) over their threshold."""


NO_ALARM = Alarm(False, math.nan, (), "", np.zeros(5))


class Watch:
    """The sequential test of all channels, with the evidence for each cause.

    A CUSUM is kept below twice its threshold, so that an alarm ends a while after its cause.
    """

    def __init__(self, bands: Bands):
        self.bands = bands
        self.cusum = np.zeros(5)
        self.alarm = NO_ALARM
        self._pressures = np.zeros((3, len(SUSPECTS), 2))
        self._body, self._pull, self._normal = 0.0, np.zeros(3), np.zeros((3, 3))

    def inside(self, window: Window) -> np.ndarray:
        """(5,) whether a window lies so well in the band that its CUSUM stays at zero."""
        over = np.nan_to_num(self.bands.deviation(window), nan=0.0)
        return (self.cusum + over - REFERENCE) <= 0.0

    def take(self, window: Window, t: float) -> Alarm:
        """The alarm with one more window, which ends at `t` [s]."""
        over = np.nan_to_num(self.bands.deviation(window), nan=REFERENCE)
        self.cusum = np.clip(self.cusum + np.minimum(over, MOST) - REFERENCE, 0.0, 2.0 * THRESHOLD)
        self._gather(window)
        before = self.alarm
        on = self.cusum > (0.0 if before.on else THRESHOLD)
        if not on.any():
            self.alarm = NO_ALARM._replace(score=self.cusum / THRESHOLD)
            return self.alarm
        channels = tuple(c for c, x in zip(BUILT_IN, on, strict=True) if x)
        since = before.since if before.on else t
        # While an alarm fades there is nothing to tell its cause from.
        lasts = bool(np.any(over > REFERENCE)) or not before.on
        hint = self._hint(on) if lasts else before.hint
        self.alarm = Alarm(True, since, channels, hint, self.cusum / THRESHOLD)
        return self.alarm

    def _gather(self, window: Window) -> None:
        """Products of the residual with what each suspect, and each tangent, would make of it."""
        variance = self.bands.variance(window)[:, None]
        there = np.isfinite(window.residual)
        r = np.where(there, window.residual, 0.0) / np.sqrt(variance)
        d = np.where(there[:2], window.faulty - window.model[:2], 0.0) / np.sqrt(variance[:2])
        rr = np.broadcast_to(np.sum(r[:2] ** 2, axis=1), d.shape[:2])
        sums = (rr, np.sum(r[:2] * d, axis=2), np.sum(d**2, axis=2))
        self._pressures = KEPT * self._pressures + np.stack(sums)
        J = np.where(there[2:], window.along[1:, 2:], 0.0) / np.sqrt(variance[2:])
        J = J.reshape(len(J), -1)
        self._normal = KEPT * self._normal + J @ J.T
        self._pull = KEPT * self._pull + J @ r[2:].ravel()
        self._body = KEPT * self._body + np.sum(r[2:] ** 2)

    def _hint(self, on: np.ndarray) -> str:
        if on[:2].any():
            return "; ".join(self._chamber(int(i)) for i in np.flatnonzero(on[:2]))
        off = ", ".join(c for c, x in zip(BUILT_IN, on, strict=True) if x)
        # The tail's stiffness and length do together what neither does alone.
        tail, K_Q = self._explained([1, 2]), self._explained([0])
        if max(K_Q, tail) < FITS:
            return f"body, tail or the sensors of {off}: pressures fit"
        cause = "changed tail" if tail > K_Q else "changed moment per pressure (K_Q)"
        return f"{cause}: pressures fit, {off} do not"

    def _explained(self, which: list[int]) -> float:
        """Share of the body's residual that the best change of some `VALUES` after k explains."""
        A, b = self._normal[np.ix_(which, which)], self._pull[which]
        size = np.sqrt(np.maximum(np.diag(A), 1e-300))
        x = np.linalg.lstsq(A / np.outer(size, size), b / size, rcond=1e-6)[0]
        return float(x @ (b / size)) / max(self._body, 1e-300)

    def _chamber(self, i: int) -> str:
        rr, rd, dd = self._pressures[:, :, i]
        size = np.maximum(rd, 0.0) / np.maximum(dd, 1e-300)
        gained = size * rd / np.maximum(rr, 1e-300)
        best = int(np.argmax(gained))
        where = ("front", "rear")[i]
        if gained[best] < FITS:
            return f"{where} chambers: pressure off, unlike leak, blocked valve or lag"
        suspect = SUSPECTS[best]
        side = {1: "_left", -1: "_right", 0: " chambers"}[suspect.side]
        return f"{suspect.cause}: {where}{side}"
