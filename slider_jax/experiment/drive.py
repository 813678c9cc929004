"""Builds the drive of a trial: the waveforms of the chambers and of all other actuators."""

from collections.abc import Callable
from functools import partial
from math import inf
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from slider_jax.actuation import (
    Actuator,
    Biased,
    Clipped,
    LengthTendon,
    MeasuredMoment,
    Recorded,
    SineWave,
    SquareWave,
    TensionTendon,
    Trapezoid,
    TravellingWave,
    Waveform,
    rear_of,
    recorded_shape,
)
from slider_jax.channels import TIME
from slider_jax.dynamics.model import Drive
from slider_jax.errors import InputError
from slider_jax.experiment.actuator_tables import ChamberTable, MomentTable, ShapeTable, TendonTable
from slider_jax.experiment.schema import ExperimentTable, Trial
from slider_jax.io.csv import read_csv, read_table

LONGEST_RECORD = 20.0
"""Largest allowed duration of a recorded drive, divided by the duration of the trial."""


def check_pascal(path: Path, columns: dict[str, np.ndarray], names: tuple[str, ...]) -> None:
    """Raises `InputError` if the largest value in the columns `names` is implausible in Pa."""
    largest = max(float(np.abs(columns[name]).max()) for name in names)
    if largest > 2e6 or 0.0 < largest < 1e3:
        raise InputError.value(
            f"{path}, column {' and '.join(names)}",
            f"a largest value of {largest:g}",
            "0, or peaks of 1e3 to 2e6 Pa",
            "pressures are in pascal, not kPa or psi",
        )


Recording = dict[str, np.ndarray]
"""Columns of a recorded drive."""


def _recording(table: ExperimentTable, trial: Trial, folder: Path) -> Recording | None:
    """Returns the columns of all actuators in a trial's recorded drive, or None for other drives.

    The columns are checked for duration and spacing.
    """
    if trial.waveform != "recorded":
        return None
    path = folder / str(trial.drive_file)
    commanded = (x for x in table.actuators if isinstance(x, (TendonTable, MomentTable)))
    names = (*_pressure_columns(table), *(x.column for x in commanded))
    columns = read_csv(path, (TIME, *names))
    times = columns[TIME]
    spacing = np.diff(times)
    if np.ptp(spacing) > 0.02 * spacing.mean():
        worst = int(np.argmax(np.abs(spacing - np.median(spacing))))
        raise InputError(
            f"{path}: mixed sample rates: the spacing of t_s is {np.median(spacing):.6g} s, but "
            f"{spacing[worst]:.6g} s after t_s = {times[worst]:g}; resample at one rate"
        )
    if times[-1] - times[0] > LONGEST_RECORD * trial.duration:
        raise InputError(
            f"{path}: t_s covers {times[0]:g} to {times[-1]:g}, but the trial {trial.file} lasts "
            f"{trial.duration:g} s; t_s must be in seconds: divide milliseconds by 1000, or cut "
            f"the recording to at most {LONGEST_RECORD:g} times the trial's duration"
        )
    if times[0] > spacing.mean() or times[-1] < trial.duration - 1.5 * spacing.mean():
        raise InputError(
            f"{path}: t_s covers {times[0]:g} to {times[-1]:g} s, but the trial {trial.file} lasts "
            f"from 0 to {trial.duration:g} s; give a longer recording or a shorter duration"
        )
    return columns


def _pressure_columns(table: ExperimentTable) -> tuple[str, ...]:
    return tuple(f"p_{name}_Pa" for name in table.chamber_names)


def _recorded(
    table: ExperimentTable, trial: Trial, folder: Path, columns: Recording
) -> tuple[Recorded, ...]:
    """Returns the recorded pressures of the chambers, cut at the limits of set pressures."""
    names = _pressure_columns(table)
    for name in names:
        check_pascal(folder / str(trial.drive_file), columns, (name,))
    series = [columns[name] for name in names]
    if trial.drive_is == "set":
        limits = pressure_limits(table)
        series = [np.clip(x, *limit) for x, limit in zip(series, limits, strict=True)]
    return tuple(Recorded(jnp.asarray(columns[TIME]), jnp.asarray(x)) for x in series)


def pressure_limits(table: ExperimentTable) -> tuple[tuple[float, float], ...]:
    """Returns the lowest and the highest set pressure [Pa] of each chamber or pair of chambers."""
    return tuple(_limits(x) for x in table.chambers)


def _limits(chamber: ChamberTable) -> tuple[float, float]:
    limit = chamber.limit or inf
    return -limit if chamber.acts_on("right") else 0.0, limit if chamber.acts_on("left") else 0.0


def actuation_of(
    table: ExperimentTable, trial: Trial, folder: Path
) -> tuple[Drive, tuple[Actuator, ...]]:
    """Returns the drive of the chambers in a trial, and all other actuators.

    `folder` contains the files of the drive and the actuators. Raises `InputError` if a file is
    invalid.
    """
    recording = _recording(table, trial, folder)
    return _drive(table, trial, folder, recording), _actuators(table, trial, folder, recording)


def _drive(
    table: ExperimentTable, trial: Trial, folder: Path, recording: Recording | None
) -> Drive:
    if recording is not None:
        recorded = _recorded(table, trial, folder, recording)
        if trial.drive_is == "measured" and recorded:
            start = jnp.stack([jnp.interp(0.0, x.times, x.values) for x in recorded])
            return Drive(recorded, start)
        return Drive(recorded, jnp.zeros(len(recorded)))
    count, wave, amplitude = len(table.chambers), _periodic(trial), trial.amplitude or 0.0
    both = zip(ratios_of(trial, count), delays_of(trial, count), strict=True)
    waves = tuple(wave(amplitude * ratio, delay) for ratio, delay in both)
    return Drive(_limited(table, trial, waves), jnp.zeros(count))


def ratios_of(trial: Trial, chambers: int) -> tuple[float, ...]:
    """Returns the amplitude of each chamber's set pressure, divided by the trial's amplitude."""
    given = trial.ratios
    return given or tuple(float(1.0 - r + r * trial.rear_ratio) for r in rear_of(chambers))


def delays_of(trial: Trial, chambers: int) -> tuple[float, ...]:
    """Returns the delay of each chamber's set pressure, as a fraction of a period."""
    return trial.phases or tuple(float(r * trial.phase) for r in rear_of(chambers))


def drive_text(trial: Trial, chambers: int) -> str:
    """Returns the ratios and the delays of the chambers' set pressures as text.

    The text is empty if all chambers have the same set pressure.
    """
    ratios, delays = ratios_of(trial, chambers), delays_of(trial, chambers)
    found = []
    if any(x != 1.0 for x in ratios):
        found.append(f"ratios {', '.join(f'{x:.3g}' for x in ratios)}")
    if any(delays):
        found.append(f"phases {', '.join(f'{x:.3g}' for x in delays)}")
    return ", ".join(found)


def _limited(
    table: ExperimentTable, trial: Trial, waves: tuple[Waveform, ...]
) -> tuple[Waveform, ...]:
    """Returns the waves with the trial's biases, cut at the limits of the chambers."""
    if trial.biases is not None:
        waves = tuple(Biased(x, bias) for x, bias in zip(waves, trial.biases, strict=True))
    limits = pressure_limits(table)
    if all(x == (-inf, inf) for x in limits):
        return waves
    return tuple(Clipped(x, *limit) for x, limit in zip(waves, limits, strict=True))


def _periodic(trial: Trial) -> Callable[..., Waveform]:
    """Returns the trial's waveform as a function of amplitude and phase."""
    kinds: dict[str, Callable[..., Waveform]] = {"square": SquareWave, "sine": SineWave}
    kind = kinds.get(trial.waveform, partial(Trapezoid, rise=trial.rise))
    return partial(kind, trial.frequency)


def _actuators(
    table: ExperimentTable, trial: Trial, folder: Path, recording: Recording | None
) -> tuple[Actuator, ...]:
    found: list[Actuator] = []
    for x in table.actuators:
        if isinstance(x, TendonTable):
            found.append(_tendon(x, _command(x, trial, recording)))
        elif isinstance(x, MomentTable):
            found.append(_moment(x, _command(x, trial, recording), folder))
        elif isinstance(x, ShapeTable):
            found.append(_shape(x, trial, folder))
    return tuple(found)


def _command(x: TendonTable | MomentTable, trial: Trial, recording: Recording | None) -> Waveform:
    """Returns the waveform of an actuator's command."""
    if recording is not None:
        return Recorded(jnp.asarray(recording[TIME]), jnp.asarray(recording[x.column]))
    return Biased(_periodic(trial)(trial.effort * x.amplitude, x.phase), x.bias)


def _tendon(x: TendonTable, command: Waveform) -> Actuator:
    span = *x.span, x.offset
    if x.stiffness is None:
        return TensionTendon(*span, command, angle=x.angle)
    return LengthTendon(*span, command, x.stiffness, x.pushes, angle=x.angle)


def _moment(x: MomentTable, command: Waveform, folder: Path) -> Actuator:
    grid = _grid(folder / x.table, "command", "curvature_per_m", "moment_N_m")
    return MeasuredMoment(*x.span, command, *map(jnp.asarray, grid))


def _shape(x: ShapeTable, trial: Trial, folder: Path) -> Actuator:
    if x.file is not None:
        times, places, curvature = _grid(folder / x.file, TIME, "s_m", "curvature_per_m")
        return recorded_shape(*x.span, places, times, trial.effort * curvature)
    assert x.amplitude is not None and x.wavelength is not None
    first, second, third = (trial.effort * a for a in x.amplitude)
    return TravellingWave(
        *x.span, trial.frequency or 0.0, x.wavelength, (first, second, third), x.phase, x.bias
    )


def _grid(path: Path, *names: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the grid of two quantities and the values (first, second) of a third quantity.

    The file has one row for each point of the grid. Raises `InputError` if a point is missing.
    """
    columns = read_table(path, names)
    (first, row), (second, column) = (
        np.unique(columns[name], return_inverse=True) for name in names[:2]
    )
    values = np.full((len(first), len(second)), np.nan)
    values[row, column] = columns[names[2]]
    missing = np.argwhere(np.isnan(values))
    if len(missing) or len(first) < 2 or len(second) < 2 or len(row) != values.size:
        given = f"{len(row)} rows with {len(first)} x {len(second)} values"
        if len(missing):
            i, j = missing[0]
            given += f", without {names[0]} = {first[i]:g} at {names[1]} = {second[j]:g}"
        raise InputError(
            f"{path}: given {given}; allowed one row for each pair of at least 2 values of "
            f"{names[0]} and 2 values of {names[1]}; complete the table"
        )
    return first, second, values
