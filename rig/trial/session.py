"""An experiment on the rig, trial after trial into a folder; stopped, it can go on."""

import hashlib
import json
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

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

RANGES = {"thrust_N": 1.0, "recoil_N": 1.0, "tip_m": 0.08}
"""What sensors range over in a trial, where none tells yet."""
LATE = 3e-3
"""Commands that are later than this, one in a hundred, are told of [s]."""
LATE_READINGS = 4e-3
"""Readings that are later than this in the middle are told of [s]: a calm computer has 0.7 ms."""
SLOW = 0.15
"""Flushes of the recording that are further apart are told of [s]."""
MAY_CHANGE = {"rig.force.host", "rig.force.port", "rig.force.page_port", "experiment_sha256"}
"""Settings that may change before a run goes on: where an instrument is, not which; and other
trials of the experiment."""
RECORDINGS = "recordings"
"""In an experiment's folder: all that came of a trial, NAME.h5, and what is told, NAME.json."""


@dataclass(frozen=True)
class Rig:
    """What trials are run with. Instruments and their readers are by the name of their stream."""

    manifold: Manifold
    switches: ManifoldSinks
    limits: PressureLimits
    instruments: dict[str, RecordedInstrument]
    readers: dict[str, StreamReader]
    force: ForceSource | None = None
    """That of the instruments, for who wants to show its latest sample."""
    analogue: tuple[AnalogueSensor, ...] = ()
    timing: TrialTiming = TrialTiming()
    pause: float = 2.0
    """Between trials, for the water to come to rest [s]: so long at least."""
    longest_pause: float = 60.0
    """So long at most, for what the analogue sensors measure to come to rest [s]."""


def run_trials(
    trials: Sequence[PlannedTrial],
    rig: Rig,
    folder: Path,
    settings: dict[str, Any],
    watch: Callable[[str, str, float], None] = lambda trial, phase, t: None,
    done: Callable[[PlannedTrial, dict[str, Any]], None] = lambda trial, told: None,
) -> list[dict[str, Any]]:
    """Each trial's CSV in `folder`, and what is to be known of it, in order.

    Trials that an earlier run with the same `settings` finished are not run again. A recording that
    one left behind unfinished is kept under another name. Raises `RigError`.
    """
    for trial in trials:
        trial.check(rig.limits)
    recordings = folder / RECORDINGS
    recordings.mkdir(parents=True, exist_ok=True)
    found: list[dict[str, Any]] = []
    for trial in trials:
        told = finished_record(folder, trial, settings)
        if told is None:
            wait_for_rest(rig, found[-1] if found else None, partial(watch, trial.name))
            told = run_trial(trial, rig, folder, settings, watch)
            done(trial, told)
        found.append(told)
    return found


def run_trial(
    trial: PlannedTrial,
    rig: Rig,
    folder: Path,
    settings: dict[str, Any],
    watch: Callable[[str, str, float], None],
) -> dict[str, Any]:
    """Runs a trial, and writes its files."""
    path = folder / RECORDINGS / f"{trial.name}.h5"
    _keep(path)
    captured = record_trial(
        trial, rig.manifold, rig.switches, rig.instruments, path, rig.limits, settings, rig.timing,
        lambda phase, t: watch(trial.name, phase, t),
    )  # fmt: skip
    read = trial_columns(
        read_recording(path), captured.played.begun_ns, trial.duration, rig.readers, rig.analogue
    )
    told = _told(trial, captured, read) | {"settings": settings, "versions": _versions()}
    write_trial(folder, trial.name, read)
    save_json(path.with_suffix(".json"), told)
    return told


def write_trial(folder: Path, name: str, read: TrialColumns) -> None:
    """NAME.csv, and NAME.played.csv with the drive as it was played, where that is known."""
    played = folder / f"{name}.played.csv"
    if read.played is None:
        played.unlink(missing_ok=True)
    else:
        save_csv(played, read.played)
    save_csv(folder / f"{name}.csv", read.values)


def start_swing(told: Sequence[dict[str, Any]]) -> float:
    """What the tip swung by before the trials began, at most: a standard deviation [m]."""
    squares = [
        x["at_rest_deviation"]["tip_m"] ** 2 - x["at_rest_noise"]["tip_m"] ** 2
        for x in told
        if "tip_m" in x["at_rest_deviation"]
    ]
    return float(np.sqrt(max([0.0, *squares])))


def wait_for_rest(
    rig: Rig, before: dict[str, Any] | None, watch: Callable[[str, float], None]
) -> None:
    """Waits, vented, for the robot to come to rest, and raises what happens meanwhile.

    `before` is what is told of the trial before, of a first one nothing; `watch` hears what is
    waited for, and since when.
    """
    # What the manifold did before this session, such as a reset, is done with.
    rig.manifold.configure(rig.limits)
    begun = time.monotonic()
    ranges = before["range"] if before else RANGES
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
        watch(f"pause{until}{f' {rig.longest_pause:g} s at most,' if until else ''}", waited)


def finished_record(
    folder: Path, trial: PlannedTrial, settings: dict[str, Any]
) -> dict[str, Any] | None:
    """What an earlier run told of a trial that it finished; None if there is none.

    Raises `RigError` if it had another drive or other settings then.
    """
    path = folder / RECORDINGS / f"{trial.name}.json"
    told = read_trial_record(path.with_suffix(".h5"))
    if told is None:
        return None
    before = {"trial": {key: told[key] for key in ("duration_s", "drive")}}
    if differ := changed_settings(told["settings"] | before, settings | {"trial": _drive(trial)}):
        raise RigError(
            f"{path}: trial {trial.name} is there already, run with another {', '.join(differ)}; "
            "give another --out, or the same settings to go on"
        )
    return told if (folder / f"{trial.name}.csv").exists() else None


def _drive(trial: PlannedTrial) -> dict[str, Any]:
    """What a trial is told to be played with; of a recorded drive a checksum."""
    plain = (str, float, int)
    drive = {key: x for key, x in asdict(trial.drive).items() if isinstance(x, plain)}
    for key in ("times", "recorded"):
        if (array := getattr(trial.drive, key)) is not None:
            drive[f"{key}_sha256"] = hashlib.sha256(np.asarray(array).tobytes()).hexdigest()
    return {"duration_s": trial.duration, "drive": drive}


def changed_settings(before: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """Full names of the settings that are not the same any more, `MAY_CHANGE` left aside."""
    # As JSON, in which tuples are lists.
    a, b = _flat(before), _flat(json.loads(json.dumps(now)))
    return sorted(key for key in {*a, *b} - MAY_CHANGE if a.get(key) != b.get(key))


def _flat(tables: dict[str, Any], name: str = "") -> dict[str, Any]:
    """Values by their full names."""
    found: dict[str, Any] = {}
    for key, value in tables.items():
        inner = isinstance(value, dict)
        found |= _flat(value, f"{name}{key}.") if inner else {f"{name}{key}": value}
    return found


def read_trial_record(recording: Path) -> dict[str, Any] | None:
    """What the run told of a recording; None of one that it did not end. Raises `RigError`."""
    path = recording.with_suffix(".json")
    try:
        told = json.loads(path.read_text())
        if {"settings", "begun_host_ns", "duration_s", "drive", "range"} <= told.keys():
            return told
    except FileNotFoundError:
        return None
    except (OSError, ValueError, AttributeError):
        pass
    raise RigError(
        f"{path}: cannot be read; move it away to run the trial again, or give another --out"
    )


def _keep(path: Path) -> None:
    """What a trial recorded before is not written over, nor what was told of it."""
    count = 1
    while path.exists():
        kept = path.with_name(f"{path.stem}.unfinished-{count}.h5")
        if not kept.exists():
            path.rename(kept)
            with suppress(FileNotFoundError):
                path.with_suffix(".json").rename(kept.with_suffix(".json"))
        count += 1


def _told(trial: PlannedTrial, captured: RecordedTrial, read: TrialColumns) -> dict[str, Any]:
    late = captured.played.lateness
    late_99 = float(np.percentile(late, 99))
    findings = list(read.record["findings"])
    if late_99 > LATE:
        findings.append(
            f"one command in a hundred was {1e3 * late_99:.1f} ms late: the computer is too busy"
        )
    if read.record["late_median_s"] > LATE_READINGS:
        findings.append(
            f"readings came {1e3 * read.record['late_median_s']:.0f} ms late in the middle: the "
            "computer is too busy, and forces may be a millisecond or two off the pressures"
        )
    if captured.load.slowest_flush > SLOW:
        findings.append(
            f"the disk was slow: {captured.load.slowest_flush:.2f} s between two flushes, which a "
            "kill would have lost"
        )
    return {
        "trial": trial.name,
        **_drive(trial),
        "begun_host_ns": captured.played.begun_ns,
        "commands": len(late),
        "command_late_99_s": late_99,
        "command_late_most_s": float(late.max()),
        "recorder_slowest_flush_s": captured.load.slowest_flush,
        **read.record,
        "findings": findings,
    }


def _versions() -> dict[str, str]:
    return {name: version(name) for name in ("slider-jax", "pyserial", "numpy", "h5py", "cobs")}
