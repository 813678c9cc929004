"""`slider rig replay`: recordings, read anew or said again."""

import json
import sys
from pathlib import Path
from typing import Annotated

import tyro

from slider_jax.cli.options import MaybeFolder, Value
from slider_jax.cli.rig import RigFile
from slider_jax.errors import InputError


def replay(
    recording: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR|RECORDING.h5")],
    out: MaybeFolder = None,
    rig: RigFile = None,
    speed: Value = 1.0,
) -> None:
    """Read recordings anew into the trials' CSVs, or say one again on a port.

    Of an experiment's folder that `slider rig run` wrote, every trial is read anew into --out, with
    the rig file's settings of today: other axes, other analogue sensors. Of one recording, what the
    manifold said is said again on a pseudo-terminal at its own pace, for any program to listen to.

    Args:
        recording: an experiment's folder, or one recording.
        out: folder for the trials read anew; made if missing, files of the same name are replaced.
        rig: TOML file of the rig; its force sensor needs its counts, as no box is asked.
        speed: of what is said again; 2 is twice as fast.
    """
    if recording.is_dir():
        if out is None:
            raise InputError("--out: given nothing; allowed a folder for the trials read anew")
        _anew(recording, out, rig)
    else:
        if out is not None:
            raise InputError(f"--out {out}: is for an experiment's folder; leave it out")
        if not 0.01 <= speed <= 100.0:
            raise InputError.value("--speed", f"{speed:g}", "0.01 to 100")
        _again(recording, speed)


def _anew(folder: Path, out: Path, rig: Path | None) -> None:
    from rig.columns import columns
    from rig.force import Mounting
    from rig.force_net import NetCalibration
    from rig.recording import read_recording
    from rig.session import RECORDINGS, write_trial
    from rig.sources import force_reader
    from slider_jax.cli.options import refuse_own_folder
    from slider_jax.cli.rig import camera_of, copy_experiment
    from slider_jax.cli.rig_settings import rig_of
    from slider_jax.files import staged

    refuse_own_folder(out, folder)
    told = sorted((folder / RECORDINGS).glob("*.json"))
    if not told:
        raise InputError(f"{folder}: holds no {RECORDINGS}/*.json; give a folder of slider rig run")
    settings = rig_of(rig)
    analogue = tuple(x.sensor() for x in settings.analogue)
    force, readers = settings.force, {}
    if force is not None:
        if force.counts_per_N is None or force.counts_per_Nm is None:
            raise InputError(f"{rig}: force.counts_per_N: missing; no box is asked in a replay")
        calibration = NetCalibration(force.counts_per_N, force.counts_per_Nm)
        readers["force"] = force_reader(calibration, Mounting(force.thrust, force.recoil))
    if settings.camera is not None:
        _, readers["camera"] = camera_of(settings.camera)
    with staged(out) as stage:
        for path in told:
            trial = json.loads(path.read_text())
            found = read_recording(path.with_suffix(".h5"))
            there = {name: x for name, x in readers.items() if name in found.streams}
            read = columns(found, trial["begun_host_ns"], trial["duration_s"], there, analogue)
            write_trial(stage, path.stem, read)
            print(f"{path.stem}.csv  {'; '.join(read.told['findings']) or 'no findings'}")
        experiment = folder / "experiment.toml"
        if experiment.exists():
            copy_experiment(experiment, stage)


def _again(path: Path, speed: float) -> None:
    from rig.recording import read_recording
    from rig.simulated.replay import Replay
    from rig.simulated.terminal import Terminal

    stream = read_recording(path).streams["manifold"]
    device = Replay(stream, speed)
    terminal = Terminal(device)
    print(f"port {terminal.path}", flush=True)
    seconds = (stream.host_ns[-1] - stream.host_ns[0]) * 1e-9 / speed if len(stream.ends) else 0.0
    print(f"{len(stream.data)} bytes in {seconds:.1f} s; Ctrl-C ends it", file=sys.stderr)
    terminal.serve(lambda: device.ended)
