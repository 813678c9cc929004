"""A recorded trial as the columns that calibration reads: all channels at the manifold's times."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from rig.errors import RigError
from rig.protocol.messages import CHANNELS
from rig.recording.clock import ClockFit, fit_clock
from rig.recording.decode import DecodedReadings, decode_readings
from rig.recording.reader import RecordedStream, Recording

ORDER = ("t_s", "p_front_Pa", "p_rear_Pa", "thrust_N", "recoil_N", "tip_m")
"""Of the columns in a trial's file."""
AVERAGED = 25
"""Readings of the quiet that are averaged before it is asked whether they move."""
NOISES = 5.0
"""Standard deviations of such a mean that noise may make of a range."""
NOT_STILL = 0.02
"""A sensor that moves in the quiet by more of its range in the drive is told of."""
FURTHEST = 0.006
"""A gap in an instrument's samples that is longer is a gap in its column [s]."""


class SampledColumns(NamedTuple):
    """What an instrument measured: host times (n,) [s], and values (n,) of each column."""

    t: np.ndarray
    columns: dict[str, np.ndarray]
    """NaN where a sample is lost or doubtful."""
    findings: tuple[str, ...]
    continuous: bool = True
    """Sampled faster than the manifold reads; else a value is given at the nearest row only."""


@dataclass(frozen=True)
class AnalogueSensor:
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


def format_value(column: str, x: float) -> str:
    """A value of a column in words, lengths in mm and pressures in kPa."""
    unit = column.rsplit("_", 1)[-1]
    factor, shown = {"m": (1e3, "mm"), "Pa": (1e-3, "kPa")}.get(unit, (1.0, unit))
    return f"{factor * x:.3g} {shown}"


StreamReader = Callable[[RecordedStream], SampledColumns]


class TrialColumns(NamedTuple):
    """A trial's file, and what has to be known about it."""

    values: dict[str, np.ndarray]
    """t_s, p_front_Pa, p_rear_Pa and what instruments give, (n,) each."""
    played: dict[str, np.ndarray] | None
    """t_s, set_front_Pa, set_rear_Pa: the signed set pressures that were followed from t_s on, the
    last row the trial's end. None where they are not known."""
    told: dict[str, Any]


def trial_columns(
    recording: Recording,
    begun_ns: int,
    duration: float,
    instruments: dict[str, StreamReader],
    analogue: tuple[AnalogueSensor, ...] = (),
) -> TrialColumns:
    """The drive's rows, t_s from `begun_ns` [host ns] to `duration` [s].

    Forces and tip are told from what they are in the quiet before the drive; pressures as they
    were read. `instruments` are by the name of their stream. Raises `RigError` for a recording
    without readings.
    """
    came = recording.streams["manifold"]
    found = decode_readings(zip(came.host_ns.tolist(), came.pieces(), strict=True))
    if len(found.seq) < 2:
        raise RigError(
            f"recording: {len(found.seq)} readings of the manifold, {found.damaged} damaged "
            "frames; check the line with `slider rig check`"
        )
    clock = fit_clock(found.device_s, found.host_s)
    t = clock.to_host(found.device_s) - begun_ns * 1e-9
    rows, quiet = (t >= 0.0) & (t <= duration), t < 0.0
    if rows.sum() < 2:
        raise RigError("recording: no readings of the manifold during the drive; record it again")
    front, rear = found.pressures()
    values = {"t_s": t[rows], "p_front_Pa": front[rows], "p_rear_Pa": rear[rows]}
    rest: dict[str, RestStatistics] = {
        name: _rest(p[quiet]) for name, p in (("p_front_Pa", front), ("p_rear_Pa", rear))
    }
    moves: tuple[str, ...] = ()
    for sensor in analogue:
        signal = sensor.signal(found.channels)
        rest[sensor.column] = _rest(signal[quiet])
        moves += _moves(sensor.column, signal[quiet], signal[rows], rest[sensor.column].noise)
        tare = rest[sensor.column].mean if sensor.zero is None else 0.0
        values[sensor.column] = (signal - tare)[rows]
    played = _played(found, clock, begun_ns, duration)
    findings = _of_line(found, clock) + moves
    if played is None:
        findings += (
            "not all set pressures that the manifold followed were told, so that the drive counts "
            "as it was meant: "
            + (
                "some were lost on the line"
                if found.follows
                else "flash the firmware in rig/firmware"
            ),
        )
    for name, read in instruments.items():
        samples = read(recording.streams[name])
        at = samples.t - begun_ns * 1e-9
        for column, signal in samples.columns.items():
            rest[column] = _rest(signal[at < 0.0])
            values[column] = resample_at_rows(
                t[rows], at, signal - rest[column].mean, samples.continuous
            )
        findings += samples.findings
    values = {name: values[name] for name in (*ORDER, *values) if name in values}
    return TrialColumns(values, played, _told(recording, found, clock, values, rest, findings))


def _played(
    found: DecodedReadings, clock: ClockFit, begun_ns: int, duration: float
) -> dict[str, np.ndarray] | None:
    if not found.follows:
        return None
    sets = np.array([x[2:] for x in found.follows], float)
    t = clock.to_host(np.array([1e-6 * x.device_us for x in found.follows])) - begun_ns * 1e-9
    # Up to the first change behind the trial: what is lost of its fade does not matter.
    needed = int(np.searchsorted(t, duration)) + 1
    steps = np.diff([x.number for x in found.follows[:needed]]) % 2**16
    if t[0] > 0.0 or (steps != 1).any():
        return None
    # What holds at the start and at the end are rows there; of changes at one time the last holds.
    before, within = np.flatnonzero(t <= 0.0)[-1], np.flatnonzero((t > 0.0) & (t < duration))
    within = within[np.append(np.diff(t[within]) > 0.0, True)[: len(within)]]
    rows = np.concatenate([[before], within, [within[-1] if len(within) else before]])
    front, rear = sets[rows, 0] - sets[rows, 1], sets[rows, 2] - sets[rows, 3]
    at = np.concatenate([[0.0], t[within], [duration]])
    return {"t_s": at, "set_front_Pa": front, "set_rear_Pa": rear}


class RestStatistics(NamedTuple):
    """What a sensor read in the quiet; 0 where there is none."""

    mean: float = 0.0
    deviation: float = 0.0
    noise: float = 0.0
    """Standard deviation of what one reading does not share with the next."""


def _rest(signal: np.ndarray) -> RestStatistics:
    there = signal[np.isfinite(signal)]
    if len(there) < 3:
        return RestStatistics()
    noise = float(np.diff(there).std() / np.sqrt(2.0))
    return RestStatistics(float(there.mean()), float(there.std()), noise)


def _moves(column: str, quiet: np.ndarray, drive: np.ndarray, noise: float) -> tuple[str, ...]:
    """What is to be told of a sensor that should have been at rest in the quiet."""
    pieces = np.array_split(quiet, max(1, len(quiet) // AVERAGED))
    before = float(np.ptp([x.mean() for x in pieces if x.size] or [0.0]))
    over = float(np.ptp(drive))
    if before <= max(NOT_STILL * over, NOISES * noise / np.sqrt(AVERAGED)):
        return ()
    return (
        f"{column} was not at rest before the drive: its range was {format_value(column, before)} "
        f"(during the drive {format_value(column, over)}); set a longer pause or fade",
    )


def resample_at_rows(
    rows: np.ndarray, at: np.ndarray, signal: np.ndarray, continuous: bool = True
) -> np.ndarray:
    """(n,) a signal (m,), sampled at times `at` (m,), at the times of `rows` (n,), all [s].

    NaN where it has no sample near enough; see `SampledColumns.continuous`.
    """
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


def _of_line(found: DecodedReadings, clock: ClockFit) -> tuple[str, ...]:
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
    found: DecodedReadings,
    clock: ClockFit,
    values: dict[str, np.ndarray],
    rest: dict[str, RestStatistics],
    findings: tuple[str, ...],
) -> dict[str, Any]:
    unkept = {name: stream.lost[0] for name, stream in recording.streams.items() if stream.lost[0]}
    if unkept:
        findings += (f"the disk was too slow for {unkept}",)
    return {
        "readings": len(found.seq),
        "rows": len(values["t_s"]),
        "readings_lost": found.lost,
        "readings_duplicated": found.duplicated,
        "frames_damaged": found.damaged,
        "clock_rate": clock.rate,
        "late_median_s": clock.late_median,
        "late_99_s": clock.late_99,
        "range": {
            name: float(np.nanmax(x) - np.nanmin(x))
            for name, x in values.items()
            if name != "t_s" and np.isfinite(x).any()
        },
        "at_rest_mean": {name: x.mean for name, x in rest.items()},
        "at_rest_deviation": {name: x.deviation for name, x in rest.items()},
        "at_rest_noise": {name: x.noise for name, x in rest.items()},
        "findings": list(findings),
    }
