"""Runs an experiment's trials and writes their files. A repeated run resumes an interrupted run."""

import hashlib
import json
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from rig.chambers import SLIDER, ChamberLayout
from rig.errors import RigError
from rig.files import save_csv, save_json
from rig.force.sensor import ForceSource
from rig.manifold.driver import Manifold
from rig.manifold.limits import PressureLimits
from rig.recording.reader import read_recording
from rig.recording.table import AnalogueSensor, StreamReader, TrialColumns, trial_columns
from rig.trial.capture import (
    ManifoldSinks,
    PlannedTrial,
    RecordedInstrument,
    RecordedTrial,
    TrialTiming,
    record_trial,
)
from rig.trial.settling import Stillness, sensor_noise

ASSUMED_RANGES = {"thrust_N": 1.0, "recoil_N": 1.0, "tip_m": 0.08}
"""Assumed ranges of the sensors before the first trial [N, N, m]."""
LATE_COMMANDS = 3e-3
"""A finding is recorded if the 99th percentile of the commands' lateness exceeds this value [s]."""
LATE_READINGS = 4e-3
"""A finding is recorded if the readings' median delay exceeds this value [s]. The median delay is
0.7 ms on a computer without other load."""
SLOW_FLUSH = 0.15
"""A finding is recorded if the time between two writes to disk exceeds this value [s]."""
MAY_CHANGE = {"rig.force.host", "rig.force.port", "rig.force.page_port", "experiment_sha256"}
"""Settings that a resumed run may change: the force sensor's address, and the checksum of the
experiment file, because trials may have been added to the file."""
RECORDINGS = "recordings"
"""Subfolder of the experiment's folder for recordings (NAME.h5) and records (NAME.json)."""


@dataclass(frozen=True)
class Rig:
    """Devices and settings of a run. The keys of `instruments` and `readers` are stream names."""

    manifold: Manifold
    sinks: ManifoldSinks
    limits: PressureLimits
    instruments: dict[str, RecordedInstrument]
    readers: dict[str, StreamReader]
    force: ForceSource | None = None
    """The force sensor of `instruments`; its latest sample is displayed during a run."""
    analogue: tuple[AnalogueSensor, ...] = ()
    timing: TrialTiming = TrialTiming()
    pause: float = 2.0
    """Shortest pause between trials, in which the water comes to rest [s]."""
    longest_pause: float = 60.0
    """Longest pause [s]. The pause ends after this time, even if a sensor still detects motion."""


def run_trials(
    trials: Sequence[PlannedTrial],
    rig: Rig,
    folder: Path,
    settings: dict[str, Any],
    watch: Callable[[str, str, float], None] = lambda trial, phase, t: None,
) -> list[dict[str, Any]]:
    """Runs all trials, writes their files to `folder`, and returns their records in order.

    If an earlier run with the same `settings` finished a trial, the trial is not repeated. An
    unfinished recording is kept under another name. `watch` is called often with the name of the
    trial, the phase of the trial, and the time since the phase began [s]. Raises `RigError`.
    """
    for trial in trials:
        trial.check(rig.limits)
    recordings = folder / RECORDINGS
    recordings.mkdir(parents=True, exist_ok=True)
    records: list[dict[str, Any]] = []
    for trial in trials:
        record = finished_record(folder, trial, settings)
        if record is None:
            wait_for_rest(rig, records[-1] if records else None, partial(watch, trial.name))
            record = run_trial(trial, rig, folder, settings, watch)
        records.append(record)
    return records


def run_trial(
    trial: PlannedTrial,
    rig: Rig,
    folder: Path,
    settings: dict[str, Any],
    watch: Callable[[str, str, float], None],
) -> dict[str, Any]:
    """Runs a trial, writes its files and returns its record."""
    path = folder / RECORDINGS / f"{trial.name}.h5"
    _rename_earlier(path)
    recorded = record_trial(
        trial, rig.manifold, rig.sinks, rig.instruments, path, rig.limits, settings, rig.timing,
        lambda phase, t: watch(trial.name, phase, t),
    )  # fmt: skip
    columns = trial_columns(
        read_recording(path), recorded.played.begun_ns, trial.duration, trial.drive.layout,
        rig.readers, rig.analogue,
    )  # fmt: skip
    record = _trial_record(trial, recorded, columns) | {
        "settings": settings,
        "versions": _versions(),
    }
    write_trial(folder, trial.name, columns)
    save_json(path.with_suffix(".json"), record)
    return record


def write_trial(folder: Path, name: str, columns: TrialColumns) -> None:
    """Writes NAME.csv, and NAME.played.csv if the played drive is known."""
    played = folder / f"{name}.played.csv"
    if columns.played is None:
        played.unlink(missing_ok=True)
    else:
        save_csv(played, columns.played)
    save_csv(folder / f"{name}.csv", columns.values)


def start_swing(records: Sequence[dict[str, Any]]) -> float:
    """Returns the tip's largest standard deviation before a trial [m], without sensor noise."""
    squares = [
        x["at_rest_deviation"]["tip_m"] ** 2 - x["at_rest_noise"]["tip_m"] ** 2
        for x in records
        if "tip_m" in x["at_rest_deviation"]
    ]
    return float(np.sqrt(max([0.0, *squares])))


def wait_for_rest(
    rig: Rig, before: dict[str, Any] | None, watch: Callable[[str, float], None]
) -> None:
    """Waits with vented chambers until the robot is at rest. Raises `RigError`.

    `before` is the previous trial's record, or None for the first trial. `watch` is called with a
    text that names the sensors whose readings still change, and with the pause's duration [s].
    """
    # `configure` clears the errors of earlier events, such as a reset of the manifold.
    rig.manifold.configure(rig.limits)
    begun = time.monotonic()
    ranges = before["range"] if before else ASSUMED_RANGES
    noise = before["at_rest_noise"] if before else sensor_noise(rig.manifold, rig.analogue)
    still = Stillness(rig.analogue, ranges, noise)
    while (waited := time.monotonic() - begun) < rig.longest_pause or waited < rig.pause:
        if waited >= rig.pause and still.reached:
            return
        time.sleep(0.05)
        rig.manifold.check()
        if rig.manifold.latest is not None:
            still.add(waited, rig.manifold.latest)
        until = still.waits_for
        limit = f" at most {rig.longest_pause:g} s," if until else ""
        watch(f"pause{until}{limit}", waited)


def finished_record(
    folder: Path, trial: PlannedTrial, settings: dict[str, Any]
) -> dict[str, Any] | None:
    """Returns the record of a trial if an earlier run finished the trial, otherwise None.

    Raises `RigError` if the earlier run used another drive or other settings.
    """
    path = folder / RECORDINGS / f"{trial.name}.json"
    record = read_trial_record(path.with_suffix(".h5"))
    if record is None:
        return None
    before = {
        "trial": {"duration_s": record["duration_s"], "drive": _per_actuator(record["drive"])}
    }
    if differ := changed_settings(record["settings"] | before, settings | {"trial": _drive(trial)}):
        raise RigError(
            f"{path}: trial {trial.name} exists already, with other values of {', '.join(differ)}; "
            "give another --out, or use the earlier settings to resume the run"
        )
    return record if (folder / f"{trial.name}.csv").exists() else None


def _drive(trial: PlannedTrial) -> dict[str, Any]:
    """Returns a trial's duration and drive for the record. Arrays are replaced by checksums."""
    keys = ("waveform", "frequency", "amplitude", "ratios", "phases", "rise")
    drive: dict[str, Any] = {key: getattr(trial.drive, key) for key in keys}
    if any(trial.drive.biases):
        drive["biases"] = trial.drive.biases
    drive["actuators"] = _actuators(trial.drive.layout)
    for key in ("times", "recorded"):
        if (array := getattr(trial.drive, key)) is not None:
            drive[f"{key}_sha256"] = hashlib.sha256(np.asarray(array).tobytes()).hexdigest()
    return {"duration_s": trial.duration, "drive": drive}


def _actuators(layout: ChamberLayout) -> list[list[str]]:
    both = zip(layout.actuators, layout.columns, strict=True)
    return [[x.name, x.side, column] for x, column in both]


def _per_actuator(drive: dict[str, Any]) -> dict[str, Any]:
    """Returns a drive of an earlier record with `ratios`, `phases` and `actuators`.

    Records of earlier versions have `rear_ratio` and `phase`, and the actuators of SLIDER.
    """
    found = {"actuators": _actuators(SLIDER)} | drive
    if "rear_ratio" in found:
        found["ratios"], found["phases"] = [1.0, found.pop("rear_ratio")], [0.0, found.pop("phase")]
    return found


def changed_settings(before: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """Returns the full names of the changed settings that are not in `MAY_CHANGE`."""
    # A round trip through JSON converts tuples to lists.
    a, b = _flat(before), _flat(json.loads(json.dumps(now)))
    return sorted(key for key in {*a, *b} - MAY_CHANGE if a.get(key) != b.get(key))


def _flat(tables: dict[str, Any], name: str = "") -> dict[str, Any]:
    """Returns the values of nested tables; the keys are full names such as `rig.force.host`."""
    found: dict[str, Any] = {}
    for key, value in tables.items():
        inner = isinstance(value, dict)
        found |= _flat(value, f"{name}{key}.") if inner else {f"{name}{key}": value}
    return found


def read_trial_record(recording: Path) -> dict[str, Any] | None:
    """Returns a recording's record, or None if the run did not finish. Raises `RigError`."""
    path = recording.with_suffix(".json")
    try:
        record = json.loads(path.read_text())
        if {"settings", "begun_host_ns", "duration_s", "drive", "range"} <= record.keys():
            return record
    except FileNotFoundError:
        return None
    except (OSError, ValueError, AttributeError):
        pass
    raise RigError(
        f"{path}: cannot be read; move it away to repeat the trial, or give another --out"
    )


def _rename_earlier(path: Path) -> None:
    """Renames the earlier recording and record of a trial, so that no file is overwritten."""
    count = 1
    while path.exists():
        kept = path.with_name(f"{path.stem}.unfinished-{count}.h5")
        if not kept.exists():
            path.rename(kept)
            with suppress(FileNotFoundError):
                path.with_suffix(".json").rename(kept.with_suffix(".json"))
        count += 1


def _trial_record(
    trial: PlannedTrial, recorded: RecordedTrial, columns: TrialColumns
) -> dict[str, Any]:
    late = recorded.played.lateness
    late_99 = float(np.percentile(late, 99))
    findings = list(columns.record["findings"])
    if late_99 > LATE_COMMANDS:
        findings.append(
            f"the computer is too busy: 1 % of the commands were over {1e3 * late_99:.1f} ms late"
        )
    if columns.record["late_median_s"] > LATE_READINGS:
        findings.append(
            f"the readings' median delay was {1e3 * columns.record['late_median_s']:.0f} ms: the "
            "computer is too busy, and the times of the forces may be wrong by 1 to 2 ms"
        )
    if recorded.load.slowest_flush > SLOW_FLUSH:
        findings.append(
            f"slow disk: a crash would have lost {recorded.load.slowest_flush:.2f} s of data"
        )
    return {
        "trial": trial.name,
        **_drive(trial),
        "begun_host_ns": recorded.played.begun_ns,
        "commands": len(late),
        "command_late_99_s": late_99,
        "command_late_most_s": float(late.max()),
        "recorder_slowest_flush_s": recorded.load.slowest_flush,
        **columns.record,
        "findings": findings,
    }


def _versions() -> dict[str, str]:
    return {name: version(name) for name in ("slider-jax", "pyserial", "numpy", "h5py", "cobs")}
