"""A recorded trial as the columns that calibration reads: all channels at the manifold's times."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from rig.clock import ClockFit, align
from rig.errors import RigError
from rig.messages import CHANNELS
from rig.readings import Readings, readings
from rig.recording import Recording, Stream

FURTHEST = 0.006
"""A gap in an instrument's samples that is longer is a gap in its column [s]."""


class Samples(NamedTuple):
    """What an instrument measured: host times (n,) [s], and values (n,) of each column."""

    t: np.ndarray
    columns: dict[str, np.ndarray]
    """NaN where a sample is lost or doubtful."""
    findings: tuple[str, ...]
    continuous: bool = True
    """Sampled faster than the manifold reads; else a value is given at the nearest row only."""


@dataclass(frozen=True)
class Analogue:
    """A sensor on one of the manifold's analogue inputs, such as a laser on the tail's tip.

    column = scale (voltage - zero), `input` 1 to 3, `scale` per volt, `zero` [V]; a `zero` of None
    is what it reads in the quiet before the drive.
    """

    column: str
    input: int
    scale: float
    zero: float | None = None

    def __post_init__(self) -> None:
        if self.input not in (1, 2, 3):
            raise RigError.value("analogue input", self.input, "1, 2 or 3")
        if not np.isfinite(self.scale) or self.scale == 0.0:
            raise RigError.value("analogue scale", self.scale, "a finite number that is not 0")

    def signal(self, channels: np.ndarray) -> np.ndarray:
        """(...) of readings' channels (..., 8), in the column's unit; from 0 V without a `zero`."""
        volts = 1e-6 * channels[..., CHANNELS.index(f"in_{self.input}_uV")]
        return self.scale * (volts - (self.zero or 0.0))


Reader = Callable[[Stream], Samples]


class Columns(NamedTuple):
    """A trial's file, and what has to be known about it."""

    values: dict[str, np.ndarray]
    """t_s, p_front_Pa, p_rear_Pa and what instruments give, (n,) each."""
    told: dict[str, Any]


def columns(
    recording: Recording,
    begun_ns: int,
    duration: float,
    instruments: dict[str, Reader],
    analogue: tuple[Analogue, ...] = (),
) -> Columns:
    """The drive's rows, t_s from `begun_ns` [host ns] to `duration` [s].

    Forces and tip are told from what they are in the quiet before the drive; pressures as they
    were read. `instruments` are by the name of their stream. Raises `RigError` for a recording
    without readings.
    """
    came = recording.streams["manifold"]
    found = readings(zip(came.host_ns.tolist(), came.pieces(), strict=True))
    if len(found.seq) < 2:
        raise RigError(
            f"recording: {len(found.seq)} readings of the manifold, {found.damaged} damaged "
            "frames; check the line with `slider rig check`"
        )
    clock = align(found.device_s, found.host_s)
    t = clock.to_host(found.device_s) - begun_ns * 1e-9
    rows, quiet = (t >= 0.0) & (t <= duration), t < 0.0
    if rows.sum() < 2:
        raise RigError("recording: no readings of the manifold during the drive; record it again")
    front, rear = found.pressures()
    values = {"t_s": t[rows], "p_front_Pa": front[rows], "p_rear_Pa": rear[rows]}
    rest: dict[str, tuple[float, float]] = {
        name: _rest(p[quiet]) for name, p in (("p_front_Pa", front), ("p_rear_Pa", rear))
    }
    for sensor in analogue:
        signal = sensor.signal(found.channels)
        rest[sensor.column] = _rest(signal[quiet])
        tare = rest[sensor.column][0] if sensor.zero is None else 0.0
        values[sensor.column] = (signal - tare)[rows]
    findings = _of_line(found, clock)
    for name, read in instruments.items():
        samples = read(recording.streams[name])
        at = samples.t - begun_ns * 1e-9
        for column, signal in samples.columns.items():
            rest[column] = _rest(signal[at < 0.0])
            values[column] = _at_rows(t[rows], at, signal - rest[column][0], samples.continuous)
        findings += samples.findings
    return Columns(values, _told(recording, found, clock, rest, findings))


def _rest(signal: np.ndarray) -> tuple[float, float]:
    """Mean and standard deviation at rest; a mean of 0 where there is no rest."""
    there = signal[np.isfinite(signal)]
    return (float(there.mean()), float(there.std())) if len(there) > 1 else (0.0, 0.0)


def _at_rows(rows: np.ndarray, at: np.ndarray, signal: np.ndarray, continuous: bool) -> np.ndarray:
    """(n,) the signal at the rows' times; NaN where it has no sample near enough."""
    there = np.isfinite(signal)
    if there.sum() < 2:
        return np.full(len(rows), np.nan)
    at, signal = at[there], signal[there]
    order = np.argsort(at, kind="stable")
    at, signal = at[order], signal[order]
    after = np.clip(np.searchsorted(at, rows), 1, len(at) - 1)
    value = np.interp(rows, at, signal, left=np.nan, right=np.nan)
    if continuous:
        return np.where(at[after] - at[after - 1] <= FURTHEST, value, np.nan)
    # Between frames nothing is known: the row nearest to each gets its value, moved there.
    nearest = np.clip(np.searchsorted(rows, at), 1, len(rows) - 1)
    nearest -= (at - rows[nearest - 1]) < (rows[nearest] - at)
    known = np.zeros(len(rows), bool)
    known[nearest[(at >= rows[0]) & (at <= rows[-1])]] = True
    return np.where(known, value, np.nan)


def _of_line(found: Readings, clock: ClockFit) -> tuple[str, ...]:
    findings = []
    if found.lost:
        findings.append(f"{found.lost} readings of the manifold were lost")
    if found.damaged:
        findings.append(f"{found.damaged} frames of the manifold came damaged, and were dropped")
    if clock.early_most > 1e-3:
        findings.append(
            f"the manifold's clock is not even: a reading is {1e3 * clock.early_most:.1f} ms early"
        )
    return tuple(findings)


def _told(
    recording: Recording,
    found: Readings,
    clock: ClockFit,
    rest: dict[str, tuple[float, float]],
    findings: tuple[str, ...],
) -> dict[str, Any]:
    unkept = {name: stream.lost[0] for name, stream in recording.streams.items() if stream.lost[0]}
    if unkept:
        findings += (f"the disk was too slow for {unkept}",)
    return {
        "readings": len(found.seq),
        "readings_lost": found.lost,
        "readings_duplicated": found.duplicated,
        "frames_damaged": found.damaged,
        "clock_rate": clock.rate,
        "late_median_s": clock.late_median,
        "late_99_s": clock.late_99,
        "at_rest_mean": {name: mean for name, (mean, _) in rest.items()},
        "at_rest_deviation": {name: deviation for name, (_, deviation) in rest.items()},
        "findings": list(findings),
    }
