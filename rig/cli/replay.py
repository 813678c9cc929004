"""`slider rig replay`: recordings, read anew or said again."""

import sys
from pathlib import Path
from typing import Annotated, NamedTuple

import tyro

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
    """Read recordings anew into the trials' CSVs, or say one again on a port.

    Of an experiment's folder that `slider rig run` wrote, every trial is read anew into --out, also
    one in which the run was killed: with the rig as it was, or as the rig file has it now, with
    other axes or analogue sensors. Of one recording, what the manifold said is said again on a
    pseudo-terminal at its own pace, from when a program opens that. Exit code 1 if a recording
    could not be read.

    Args:
        recording: an experiment's folder, or one recording.
        out: folder for the trials read anew; made if missing, files of the same name are replaced.
        rig: TOML file of the rig, all of whose sensors count, and no others; by default the rig as
            it was recorded. A force sensor's counts are the recorded ones where it has none.
        speed: of what is said again; 2 is twice as fast.
    """
    if recording.is_dir():
        if out is None:
            raise InputError("--out: given nothing; allowed a folder for the trials read anew")
        if speed != 1.0:
            raise InputError(f"--speed {speed:g}: is for one recording; leave it out")
        return _anew(recording, out, rig)
    if out is not None:
        raise InputError(f"--out {out}: is for an experiment's folder; leave it out")
    if not 0.01 <= speed <= 100.0:
        raise InputError.value("--speed", f"{speed:g}", "0.01 to 100")
    _again(recording, speed)
    return 0


def _anew(folder: Path, out: Path, rig: Path | None) -> int:
    from rig.cli.settings import load_rig
    from rig.cli.shared import copy_experiment
    from slider_jax.cli.options import refuse_own_folder
    from slider_jax.io.files import staged

    refuse_own_folder(out, folder)
    paths = sorted((folder / RECORDINGS).glob("*.h5"))
    if not paths:
        raise InputError(f"{folder}: holds no {RECORDINGS}/*.h5; give a folder of slider rig run")
    given = load_rig(rig) if rig is not None else None
    experiment, meant = folder / "experiment.toml", dict[str, float]()
    if experiment.exists():
        meant = {x.name: x.duration for x in load_trials(experiment)[1]}
    left_out = 0
    with staged(out) as stage:
        for path in paths:
            try:
                trial = _trial(path, meant)
                read, missing = _read(trial, given, path)
            except RigError as error:
                left_out += 1
                print(f"{path.name}: left out: {error}", file=sys.stderr)
                continue
            write_trial(stage, path.stem, read)
            said = [*trial.findings, *missing, *read.record["findings"]]
            print(f"{path.stem}.csv  {'; '.join(said) or 'no findings'}")
        if left_out == len(paths):
            raise InputError(f"{folder}: no recording could be read; nothing is written")
        if meant:
            copy_experiment(experiment, stage)
    return 1 if left_out else 0


class _Trial(NamedTuple):
    """A recording, and when the drive was in it."""

    recording: Recording
    begun_ns: int
    seconds: float
    columns: tuple[str, ...]
    """That were read from it by the run itself."""
    findings: tuple[str, ...]


def _trial(path: Path, meant: dict[str, float]) -> _Trial:
    """Also of a run that was killed in it, of which nothing else tells. `meant` [s] is how long the
    experiment's trials are, by name."""
    recording, told = read_recording(path), read_trial_record(path)
    if told is not None:
        return _Trial(
            recording, told["begun_host_ns"], told["duration_s"], tuple(told["range"]), ()
        )
    found = drive_span(recording)
    seconds = min(found.seconds, meant.get(path.stem.split(".unfinished-")[0], found.seconds))
    cut = f"unfinished: {seconds:.2f} s of its drive were recorded"
    return _Trial(recording, found.begun_ns, seconds, (), (cut,))


def _read(trial: _Trial, given: RigTable | None, path: Path) -> tuple[TrialColumns, list[str]]:
    """Return the columns by the `given` rig, else by the recorded rig; and a finding if columns
    of the original run are missing."""
    there = trial.recording.settings.get("rig", {})
    recorded = validate(RigTable, there, f"{path}: its settings")
    settings = recorded if given is None else given
    force, readers = settings.force, {}
    if force is not None and "force" in trial.recording.streams:
        if force.counts_per_N is None and recorded.force is not None:
            names = ("counts_per_N", "counts_per_Nm")
            counts = {name: getattr(recorded.force, name) for name in names}
            force = force.model_copy(update=counts)
        if force.counts_per_N is None:
            raise InputError(
                f"{path}: force.counts_per_N: not known, and no box is asked in a replay; give "
                "--rig with counts_per_N and counts_per_Nm"
            )
        mounting = SensorMounting(force.thrust, force.recoil)
        readers["force"] = force_reader(force_calibration(force), mounting)
    if settings.camera is not None and "camera" in trial.recording.streams:
        _, readers["camera"] = marker_camera(settings.camera)
    analogue = tuple(x.sensor() for x in settings.analogue)
    read = trial_columns(trial.recording, trial.begun_ns, trial.seconds, readers, analogue)
    missing = [name for name in trial.columns if name not in read.values]
    return read, [f"{', '.join(missing)} left out: no sensor of it is named"] if missing else []


def _again(path: Path, speed: float) -> None:
    from rig.simulated.bench import ReplayDevice
    from rig.simulated.terminal import Terminal

    stream = read_recording(path).streams["manifold"]
    device = ReplayDevice(stream, speed)
    terminal = Terminal(device)
    print(f"port {terminal.path}", flush=True)
    seconds = (stream.host_ns[-1] - stream.host_ns[0]) * 1e-9 / speed if len(stream.ends) else 0.0
    print(
        f"{len(stream.data)} bytes in {seconds:.1f} s, from when a program opens the port; "
        "Ctrl-C ends it",
        file=sys.stderr,
    )
    terminal.wait_for_host()
    terminal.serve(lambda: device.ended)
