"""Converts a recorded trial to the columns of the trial's CSV file, at the readings' times."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from rig.chambers import ChamberLayout
from rig.errors import RigError
from rig.protocol.messages import OTHER_CHANNELS
from rig.recording.clock import ClockFit, fit_clock
from rig.recording.decode import DecodedReadings, decode_readings
from rig.recording.reader import RecordedStream, Recording

BODY_COLUMNS = ("thrust_N", "recoil_N", "tip_m")
"""Columns of a trial's file after the time and the pressures, in this order."""
AVERAGED = 25
"""Number of readings per mean. The means show whether the robot moved before the drive started."""
QUIET_NOISE_RANGE = 5.0
"""Largest range of these means if the robot is at rest, in standard deviations of one mean."""
QUIET_RANGE = 0.02
"""Largest range of a sensor before the drive, as a fraction of its range during the drive."""
MAX_SAMPLE_GAP = 0.006
"""Longest interval between two samples of an instrument in which values are interpolated [s]."""


class SampledColumns(NamedTuple):
    """An instrument's samples: host times (n,) [s], and values (n,) of each column."""

    t: np.ndarray
    columns: dict[str, np.ndarray]
    """NaN for lost or invalid samples."""
    findings: tuple[str, ...]
    continuous: bool = True
    """True if the instrument samples faster than the manifold. If False, only the table's row that
    is nearest to a sample gets a value."""


@dataclass(frozen=True)
class AnalogueSensor:
    """A sensor on the analogue input `input` (1 to 3), such as a laser that measures the tip.

    The value of `column` is scale (voltage - zero), with `scale` [unit of the column / V] and
    `zero` [V]. If `zero` is None, the mean voltage at rest before the drive is used.
    """

    column: str
    input: int
    scale: float
    zero: float | None = None

    def __post_init__(self) -> None:
        if self.input not in (1, 2, 3):
            raise RigError.value("analogue input", self.input, "1, 2 or 3")
        if not np.isfinite(self.scale) or self.scale == 0.0:
            raise RigError.value("analogue scale", self.scale, "a finite number except 0")

    def signal(self, channels: np.ndarray) -> np.ndarray:
        """Returns values (...) for channels (..., channels), without tare if `zero` is None."""
        at = OTHER_CHANNELS.index(f"in_{self.input}_uV") - len(OTHER_CHANNELS)
        volts = 1e-6 * channels[..., at]
        return self.scale * (volts - (self.zero or 0.0))


def format_value(column: str, x: float) -> str:
    """Returns a column's value as text with the unit: mm for lengths, kPa for pressures."""
    unit = column.rsplit("_", 1)[-1]
    factor, shown = {"m": (1e3, "mm"), "Pa": (1e-3, "kPa")}.get(unit, (1.0, unit))
    return f"{factor * x:.3g} {shown}"


StreamReader = Callable[[RecordedStream], SampledColumns]


class TrialColumns(NamedTuple):
    """The columns of a trial's files, and a record of the data's quality."""

    values: dict[str, np.ndarray]
    """Columns t_s and those of the pressures and the instruments, each of shape (n,)."""
    played: dict[str, np.ndarray] | None
    """Columns t_s and set_NAME_Pa of each actuator: signed set pressures that the valves followed
    from time t_s on. The last row is the drive's end. None if a change was not recorded."""
    record: dict[str, Any]
    """Content of the trial's JSON file: losses, delays, ranges, statistics at rest, findings."""


def trial_columns(
    recording: Recording,
    begun_ns: int,
    duration: float,
    layout: ChamberLayout,
    instruments: dict[str, StreamReader],
    analogue: tuple[AnalogueSensor, ...] = (),
) -> TrialColumns:
    """Returns the columns for `duration` [s] from the drive's start `begun_ns` (host time [ns]).

    The means at rest before the drive are subtracted from forces and tip, not from pressures.
    `instruments` maps a stream's name to its reader. Raises `RigError` for fewer than two readings,
    and for a manifold with another number of chambers than `layout`.
    """
    received = recording.streams["manifold"]
    readings = decode_readings(zip(received.host_ns.tolist(), received.pieces(), strict=True))
    if len(readings.seq) < 2:
        raise RigError(
            f"recording: {len(readings.seq)} readings of the manifold, {readings.damaged} damaged "
            "frames; at least 2 readings are needed; check the connection with `slider rig check`"
        )
    there = readings.channels.shape[1] - len(OTHER_CHANNELS)
    if there != len(layout.names):
        raise RigError(
            f"recording: chambers: the manifold has {there}, but the robot has "
            f"{len(layout.names)} ({', '.join(layout.names)}); put the robot's experiment.toml "
            "into the folder of the recordings"
        )
    clock = fit_clock(readings.device_s, readings.host_s)
    t = clock.to_host(readings.device_s) - begun_ns * 1e-9
    rows, quiet = (t >= 0.0) & (t <= duration), t < 0.0
    if rows.sum() < 2:
        raise RigError("recording: no readings of the manifold during the drive; repeat the trial")
    signed = dict(zip(layout.columns, layout.signed(readings.channels.T), strict=True))
    values = {"t_s": t[rows]} | {name: p[rows] for name, p in signed.items()}
    at_rest = {name: _rest(p[quiet]) for name, p in signed.items()}
    motion: tuple[str, ...] = ()
    for sensor in analogue:
        signal = sensor.signal(readings.channels)
        at_rest[sensor.column] = _rest(signal[quiet])
        motion += _motion_findings(
            sensor.column, signal[quiet], signal[rows], at_rest[sensor.column].noise
        )
        tare = at_rest[sensor.column].mean if sensor.zero is None else 0.0
        values[sensor.column] = (signal - tare)[rows]
    played = _played_drive(readings, layout, clock, begun_ns, duration)
    findings = _manifold_findings(readings, clock) + motion
    if played is None:
        findings += (
            "the manifold did not report all set pressures that it followed; the planned drive is "
            "used instead: "
            + (
                "some reports were lost"
                if readings.follows
                else "the manifold reported none; flash the firmware in rig/firmware"
            ),
        )
    for name, read in instruments.items():
        samples = read(recording.streams[name])
        at = samples.t - begun_ns * 1e-9
        for column, signal in samples.columns.items():
            at_rest[column] = _rest(signal[at < 0.0])
            values[column] = resample_at_rows(
                t[rows], at, signal - at_rest[column].mean, samples.continuous
            )
        findings += samples.findings
    order = ("t_s", *layout.columns, *BODY_COLUMNS, *values)
    values = {name: values[name] for name in order if name in values}
    record = _quality_record(recording, readings, clock, values, at_rest, findings)
    return TrialColumns(values, played, record)


def _played_drive(
    readings: DecodedReadings,
    layout: ChamberLayout,
    clock: ClockFit,
    begun_ns: int,
    duration: float,
) -> dict[str, np.ndarray] | None:
    """Returns the columns of the played drive, or None if a change before `duration` was lost."""
    if not readings.follows:
        return None
    sets = np.array([x.pressures for x in readings.follows], float)
    t = clock.to_host(np.array([1e-6 * x.device_us for x in readings.follows])) - begun_ns * 1e-9
    # Changes after `duration`, in the fade, are not needed.
    needed = int(np.searchsorted(t, duration)) + 1
    steps = np.diff([x.number for x in readings.follows[:needed]]) % 2**16
    if t[0] > 0.0 or (steps != 1).any():
        return None
    # The first row contains the set pressures at t = 0, the last row those at the end. If several
    # changes have the same time, only the last change is kept.
    before, within = np.flatnonzero(t <= 0.0)[-1], np.flatnonzero((t > 0.0) & (t < duration))
    within = within[np.append(np.diff(t[within]) > 0.0, True)[: len(within)]]
    rows = np.concatenate([[before], within, [within[-1] if len(within) else before]])
    at = np.concatenate([[0.0], t[within], [duration]])
    return {"t_s": at} | dict(zip(layout.set_columns, layout.signed(sets[rows].T), strict=True))


class RestStatistics(NamedTuple):
    """Statistics of a sensor at rest before the drive. All are 0 for fewer than three readings."""

    mean: float = 0.0
    deviation: float = 0.0
    """Standard deviation of the readings."""
    noise: float = 0.0
    """Standard deviation of the part of the signal that is independent between readings."""


def _rest(signal: np.ndarray) -> RestStatistics:
    valid = signal[np.isfinite(signal)]
    if len(valid) < 3:
        return RestStatistics()
    noise = float(np.diff(valid).std() / np.sqrt(2.0))
    return RestStatistics(float(valid.mean()), float(valid.std()), noise)


def _motion_findings(
    column: str, quiet: np.ndarray, drive: np.ndarray, noise: float
) -> tuple[str, ...]:
    """Returns a finding if a sensor was not at rest before the drive, otherwise an empty tuple."""
    pieces = np.array_split(quiet, max(1, len(quiet) // AVERAGED))
    before = float(np.ptp([x.mean() for x in pieces if x.size] or [0.0]))
    over = float(np.ptp(drive))
    if before <= max(QUIET_RANGE * over, QUIET_NOISE_RANGE * noise / np.sqrt(AVERAGED)):
        return ()
    return (
        f"{column} was not at rest before the drive: its range was {format_value(column, before)} "
        f"(during the drive {format_value(column, over)}); set a longer pause or fade",
    )


def resample_at_rows(
    rows: np.ndarray, at: np.ndarray, signal: np.ndarray, continuous: bool = True
) -> np.ndarray:
    """Returns the values (n,) at times `rows` (n,) [s] of a `signal` (m,) sampled at `at` (m,) [s].

    Rows without a nearby sample are NaN. `continuous` is defined in `SampledColumns`.
    """
    valid = np.isfinite(signal)
    if valid.sum() < 2:
        return np.full(len(rows), np.nan)
    at, signal = at[valid], signal[valid]
    order = np.argsort(at, kind="stable")
    at, signal = at[order], signal[order]
    after = np.clip(np.searchsorted(at, rows), 1, len(at) - 1)
    value = np.interp(rows, at, signal, left=np.nan, right=np.nan)
    if continuous:
        return np.where(at[after] - at[after - 1] <= MAX_SAMPLE_GAP, value, np.nan)
    # The signal between two samples is unknown. Therefore only the row nearest to a sample gets a
    # value, which is interpolated to the row's time.
    nearest = np.clip(np.searchsorted(rows, at), 1, len(rows) - 1)
    nearest -= (at - rows[nearest - 1]) < (rows[nearest] - at)
    known = np.zeros(len(rows), bool)
    known[nearest[(at >= rows[0]) & (at <= rows[-1])]] = True
    return np.where(known, value, np.nan)


def _manifold_findings(readings: DecodedReadings, clock: ClockFit) -> tuple[str, ...]:
    findings = []
    if readings.lost:
        findings.append(f"{readings.lost} readings of the manifold were lost")
    if readings.damaged:
        findings.append(f"{readings.damaged} damaged frames of the manifold were dropped")
    if clock.early_max > 1e-3:
        findings.append(
            f"the manifold's clock is irregular, with deviations of {1e3 * clock.early_max:.1f} ms"
        )
    return tuple(findings)


def _quality_record(
    recording: Recording,
    readings: DecodedReadings,
    clock: ClockFit,
    values: dict[str, np.ndarray],
    at_rest: dict[str, RestStatistics],
    findings: tuple[str, ...],
) -> dict[str, Any]:
    unwritten = {name: x.lost[0] for name, x in recording.streams.items() if x.lost[0]}
    if unwritten:
        findings += (f"the disk was too slow; lost pieces of data in each stream: {unwritten}",)
    return {
        "readings": len(readings.seq),
        "rows": len(values["t_s"]),
        "readings_lost": readings.lost,
        "readings_duplicated": readings.duplicated,
        "frames_damaged": readings.damaged,
        "clock_rate": clock.rate,
        "late_median_s": clock.late_median,
        "late_99_s": clock.late_99,
        "range": {
            name: float(np.nanmax(x) - np.nanmin(x))
            for name, x in values.items()
            if name != "t_s" and np.isfinite(x).any()
        },
        "at_rest_mean": {name: x.mean for name, x in at_rest.items()},
        "at_rest_deviation": {name: x.deviation for name, x in at_rest.items()},
        "at_rest_noise": {name: x.noise for name, x in at_rest.items()},
        "findings": list(findings),
    }
