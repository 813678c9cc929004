"""`slider rig replay`: converts recordings to CSV again, or plays one recording back on a port."""

import sys
from pathlib import Path
from typing import Annotated, NamedTuple

import tyro

from rig.chambers import SLIDER, ChamberLayout
from rig.cli.settings import RigTable
from rig.cli.shared import RigFile, force_calibration, load_trials, marker_camera
from rig.errors import RigError
from rig.force.sensor import SensorMounting, force_reader
from rig.recording.decode import drive_span
from rig.recording.reader import Recording, read_recording
from rig.recording.table import TrialColumns, trial_columns
from rig.trial.session import RECORDINGS, read_trial_record, write_trial
from slider_jax.cli.options import MaybeFolder, Value
from slider_jax.errors import InputError
from slider_jax.io.toml import validate


def rig_replay(
    recording: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR|RECORDING.h5")],
    out: MaybeFolder = None,
    rig: RigFile = None,
    speed: Value = 1.0,
) -> int:
    """Converts a run's recordings to CSV files again, or plays one recording back on a port.

    With an output folder of `slider rig run`, the command converts all recordings of the folder to
    CSV files in --out, including those of a killed run. With --rig, the rig file's sensors and axes
    replace those of the run. With a single recording, the command creates a pseudo-terminal. When a
    program opens this port, the command sends the manifold's recorded bytes at the recorded times.
    The exit code is 1 if a recording could not be read.

    Args:
        recording: output folder of `slider rig run`, or one recording (.h5).
        out: folder for the converted trials, required for an experiment's folder; created if
            missing. Existing files are replaced.
        rig: TOML file of the rig. The sensors of this file replace the recorded sensors. If the
            file does not contain the force sensor's counts, the recorded counts are used.
        speed: playback speed as a multiple of the recorded speed.
    """
    if recording.is_dir():
        if out is None:
            raise InputError("--out: missing; give a folder for the converted trials")
        if speed != 1.0:
            raise InputError(f"--speed {speed:g}: needs a single recording; omit --speed")
        return _convert(recording, out, rig)
    if out is not None:
        raise InputError(f"--out {out}: needs an experiment's folder; omit --out")
    if not 0.01 <= speed <= 100.0:
        raise InputError.value("--speed", f"{speed:g}", "0.01 to 100")
    _play_back(recording, speed)
    return 0


def _convert(folder: Path, out: Path, rig: Path | None) -> int:
    from rig.cli.settings import load_rig
    from rig.cli.shared import copy_experiment
    from slider_jax.cli.options import refuse_own_folder
    from slider_jax.io.files import staged

    refuse_own_folder(out, folder)
    paths = sorted((folder / RECORDINGS).glob("*.h5"))
    if not paths:
        raise InputError(f"{folder}: has no {RECORDINGS}/*.h5; give a folder of `slider rig run`")
    given = load_rig(rig) if rig is not None else None
    experiment, durations, layout = folder / "experiment.toml", dict[str, float](), SLIDER
    if experiment.exists():
        trials = load_trials(experiment)[1]
        durations, layout = {x.name: x.duration for x in trials}, trials[0].drive.layout
    failed = 0
    with staged(out) as stage:
        for path in paths:
            try:
                trial = _read_trial(path, durations)
                columns, missing = _read_columns(trial, layout, given, path)
            except RigError as error:
                failed += 1
                print(f"{path.name}: not converted: {error}", file=sys.stderr)
                continue
            write_trial(stage, path.stem, columns)
            findings = [*trial.findings, *missing, *columns.record["findings"]]
            print(f"{path.stem}.csv  {'; '.join(findings) or 'no findings'}")
        if failed == len(paths):
            raise InputError(f"{folder}: no recording could be read; nothing was written")
        if durations:
            copy_experiment(experiment, stage)
    return 1 if failed else 0


class _Trial(NamedTuple):
    """A recording, and the start and duration of its drive."""

    recording: Recording
    begun_ns: int
    """Host time of the drive's first command [ns]."""
    seconds: float
    """Duration of the drive [s]."""
    columns: tuple[str, ...]
    """Names of the columns that the run wrote."""
    findings: tuple[str, ...]


def _read_trial(path: Path, durations: dict[str, float]) -> _Trial:
    """Returns the trial of a recording, also if the run was killed before it wrote a record.

    `durations` contains the duration of each trial of the experiment by name [s].
    """
    recording, record = read_recording(path), read_trial_record(path)
    if record is not None:
        columns = tuple(record["range"])
        return _Trial(recording, record["begun_host_ns"], record["duration_s"], columns, ())
    span = drive_span(recording)
    seconds = min(span.seconds, durations.get(path.stem.split(".unfinished-")[0], span.seconds))
    finding = f"unfinished: only {seconds:.2f} s of the drive were recorded"
    return _Trial(recording, span.begun_ns, seconds, (), (finding,))


def _read_columns(
    trial: _Trial, layout: ChamberLayout, given: RigTable | None, path: Path
) -> tuple[TrialColumns, list[str]]:
    """Returns a trial's columns for the sensors of the rig file `given` (None: recorded sensors).
    Also returns a finding if columns of the original run are missing."""
    stored = trial.recording.settings.get("rig", {})
    recorded = validate(RigTable, stored, f"{path}: settings")
    settings = recorded if given is None else given
    force, readers = settings.force, {}
    if force is not None and "force" in trial.recording.streams:
        if force.counts_per_N is None and recorded.force is not None:
            names = ("counts_per_N", "counts_per_Nm")
            counts = {name: getattr(recorded.force, name) for name in names}
            force = force.model_copy(update=counts)
        if force.counts_per_N is None:
            raise InputError(
                f"{path}: force.counts_per_N: is missing, and a replay cannot read the box; give "
                "--rig with counts_per_N and counts_per_Nm"
            )
        mounting = SensorMounting(force.thrust, force.recoil)
        readers["force"] = force_reader(force_calibration(force), mounting)
    if settings.camera is not None and "camera" in trial.recording.streams:
        _, readers["camera"] = marker_camera(settings.camera)
    analogue = tuple(x.sensor() for x in settings.analogue)
    columns = trial_columns(
        trial.recording, trial.begun_ns, trial.seconds, layout, readers, analogue
    )
    missing = [name for name in trial.columns if name not in columns.values]
    return columns, [f"no {', '.join(missing)}: the rig file has no such sensor"] if missing else []


def _play_back(path: Path, speed: float) -> None:
    from rig.simulated.bench import ReplayDevice
    from rig.simulated.terminal import Terminal

    stream = read_recording(path).streams["manifold"]
    device = ReplayDevice(stream, speed)
    terminal = Terminal(device)
    print(f"port {terminal.path}", flush=True)
    seconds = (stream.host_ns[-1] - stream.host_ns[0]) * 1e-9 / speed if len(stream.ends) else 0.0
    print(
        f"when a program opens the port, the command sends {len(stream.data)} bytes in "
        f"{seconds:.1f} s; press Ctrl-C to stop",
        file=sys.stderr,
    )
    terminal.wait_for_host()
    terminal.serve(lambda: device.ended)
