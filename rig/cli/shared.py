"""`slider rig ports`, and functions that several of the rig's commands use."""

import shutil
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from math import inf
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tomlkit
import tyro

from rig.chambers import SLIDER, ChamberLayout, PneumaticActuator
from rig.cli.settings import CameraTable, ForceTable, RigTable
from rig.force.ati_net import NetCalibration, NetForce
from rig.force.sensor import ForceSource, SensorMounting, force_reader
from rig.manifold.driver import Manifold
from rig.manifold.limits import PressureLimits
from rig.protocol.messages import MOST_CHAMBERS
from rig.recording.table import StreamReader
from rig.scheduling import real_time_priority
from rig.trial.capture import (
    ManifoldSinks,
    PlannedTrial,
    RecordedInstrument,
    SwitchableSink,
    TrialTiming,
)
from rig.trial.session import Rig, start_swing
from rig.trial.waveform import ChamberDrive
from slider_jax.errors import InputError
from slider_jax.experiment.schema import ExperimentTable, Trial as TrialTable
from slider_jax.io.csv import read_csv
from slider_jax.io.files import write_bytes, write_text
from slider_jax.io.toml import read_toml, significant, validate

Port = Annotated[str, tyro.conf.arg(metavar="PORT")]
RigFile = Annotated[
    Path | None, tyro.conf.arg(metavar="RIG.toml", help_behavior_hint="(default: none)")
]
LEAST_SWING = 1e-4
"""Smallest standard deviation of the tip at rest [m] that is written to the experiment file."""


def rig_ports() -> None:
    """Lists this computer's serial ports with name, description and serial number."""
    from rig.manifold.serial_port import serial_ports

    available = serial_ports()
    for port in available:
        print(f"{port.name}  {port.description}  {port.serial_number}".rstrip())
    if not available:
        print("no serial ports; connect the manifold, or start `slider rig simulate`")


def load_trials(path: Path) -> tuple[ExperimentTable, list[PlannedTrial]]:
    """Returns an experiment file's tables, and its trials as the rig drives them.

    Raises `InputError` if the file is invalid.
    """
    experiment = validate(ExperimentTable, read_toml(path), str(path))
    layout = layout_of(experiment, path)
    return experiment, [planned_trial(x, layout, path) for x in experiment.trials]


def layout_in(path: Path | None) -> ChamberLayout:
    """Returns the chambers of an experiment file's robot; SLIDER's if `path` is None."""
    if path is None:
        return SLIDER
    return layout_of(validate(ExperimentTable, read_toml(path), str(path)), path)


def layout_of(experiment: ExperimentTable, path: Path) -> ChamberLayout:
    """Returns the chambers of an experiment's robot. Raises `InputError` if there are none."""
    columns = {x.actuator: x.columns[0] for x in experiment.sensors.channels if x.actuator}
    found = tuple(
        PneumaticActuator(x.name, x.side, x.limit or inf, columns.get(x.name, ""))
        for x in experiment.chambers
    )
    if not found:
        allowed = "one or more pneumatic actuators, which the rig drives"
        raise InputError.value(f"{path}: the robot's chambers", "none", allowed)
    layout = ChamberLayout(found)
    if len(layout.names) > MOST_CHAMBERS:
        allowed = f"at most {MOST_CHAMBERS}, because a reading must fit into a frame"
        raise InputError.value(f"{path}: the robot's chambers", len(layout.names), allowed)
    return layout


def copy_experiment(path: Path, folder: Path) -> None:
    """Copies an experiment file to experiment.toml in a folder, and the files that it names."""
    table, _ = load_trials(path)
    write_bytes(folder / "experiment.toml", path.read_bytes())
    drives = [x.drive_file for x in table.trials if x.drive_file]
    for name in {*drives, *table.files}:
        write_bytes(folder / name, (path.parent / name).read_bytes())


def install_experiment(path: Path, folder: Path) -> None:
    """Copies an experiment file to a folder that may contain the copy of an earlier run.

    If the earlier copy differs only by added trials and the measured swing, this copy remains.
    Raises `InputError` if the folder contains measured trials that the file does not contain.
    """
    earlier = folder / "experiment.toml"
    if earlier.exists():
        present, given = (_without_swing(read_toml(x)) for x in (earlier, path))
        trials, before = given.get("trials", []), present.get("trials", [])
        if present | {"trials": before[: len(trials)]} == given | {"trials": trials}:
            return
        given_files = {x["file"] for x in trials}
        extra = [x["file"] for x in before if x["file"] not in given_files]
        if extra := [name for name in extra if (folder / name).exists()]:
            raise InputError(
                f"{folder}: contains {', '.join(extra)}, not in {path}; give another --out, or add "
                "these trials to the file"
            )
    copy_experiment(path, folder)


def _without_swing(tables: dict[str, Any]) -> dict[str, Any]:
    sensors = {k: v for k, v in tables.pop("sensors", {}).items() if k != "start_swing"}
    return tables | ({"sensors": sensors} if sensors else {})


def declare_swing(path: Path, records: list[dict[str, Any]]) -> None:
    """Writes the tip's measured swing to an experiment file if above twice the declared swing."""
    swing = start_swing(records)
    declared = validate(ExperimentTable, read_toml(path), str(path)).sensors.start_swing
    if swing <= max(2.0 * declared, LEAST_SWING):
        return
    document = tomlkit.parse(path.read_text())
    sensors = document.setdefault("sensors", {})
    sensors["start_swing"] = tomlkit.item(significant(swing, 2)).comment("m, measured at rest")
    write_text(path, tomlkit.dumps(document))
    print(f"{path}: start_swing is {swing:.2g} m, as measured before the trials", file=sys.stderr)


def planned_trial(trial: TrialTable, layout: ChamberLayout, path: Path) -> PlannedTrial:
    """Returns a trial of the file `path` as the rig plays it.

    Raises `InputError` for a "measured" drive.
    """
    name = Path(trial.file).stem
    if trial.waveform != "recorded":
        rear = np.linspace(0.0, 1.0, len(layout.actuators))
        ratios = trial.ratios or (1.0 - rear + rear * trial.rear_ratio).tolist()
        phases = trial.phases or (rear * trial.phase).tolist()
        drive = ChamberDrive(
            trial.waveform, trial.frequency or 0.0, trial.amplitude or 0.0, tuple(ratios),
            tuple(phases), trial.biases or (), trial.rise, layout=layout,
        )  # fmt: skip
        return PlannedTrial(name, drive, trial.duration)
    if trial.drive_is == "measured":
        raise InputError(
            f'{path}: trial {trial.file}: drive_is = "measured"; allowed "set", because the rig '
            "cannot follow measured pressures"
        )
    names = [f"p_{x.name}_Pa" for x in layout.actuators]
    columns = read_csv(path.parent / str(trial.drive_file), ("t_s", *names))
    recorded = np.stack([columns[name] for name in names], axis=1)
    drive = ChamberDrive("recorded", times=columns["t_s"], recorded=recorded, layout=layout)
    return PlannedTrial(name, drive, trial.duration)


def warn_of_moving_clamp(trial: TrialTable) -> None:
    """Prints a warning if a trial is free, or its clamp moves: the rig plays only the drive."""
    if trial.support == "free":
        print(
            f'{trial.file}: support = "free"; the rig only plays the drive: make sure that no '
            "clamp holds the robot",
            file=sys.stderr,
        )
    if trial.tow_speed or trial.clamp_moves:
        moves = "is towed" if trial.tow_speed else "moves"
        print(f"{trial.file}: the clamp {moves}; the rig does not do this", file=sys.stderr)


def warn_of_missing_sensors(experiment: ExperimentTable, settings: RigTable) -> None:
    """Prints a warning about sensors of the experiment that the rig file does not contain."""
    known = {"thrust_N", "recoil_N", "tip_m", *(x.column for x in settings.analogue)}
    declared = [x for x in experiment.sensors.channels if not x.actuator]
    if missing := [c for x in declared for c in x.columns if c not in known]:
        print(
            f"the rig does not record {', '.join(missing)}: the measured files will not contain "
            "these columns; add them from your own instrument",
            file=sys.stderr,
        )


def with_force_counts(settings: RigTable) -> RigTable:
    """Returns the settings with the calibration of the force sensor (counts per N and per N m).

    If the calibration is missing, it is read from the web page of the force sensor's box. A
    recording stores the calibration, so that the recording can be converted without the box.
    """
    if settings.force is None:
        return settings
    found = force_calibration(settings.force)
    counts = {"counts_per_N": found.counts_per_N, "counts_per_Nm": found.counts_per_Nm}
    return settings.model_copy(update={"force": settings.force.model_copy(update=counts)})


def force_calibration(table: ForceTable) -> NetCalibration:
    """Returns the calibration from the table, or from the box's web page if counts are missing."""
    if table.counts_per_N is not None and table.counts_per_Nm is not None:
        return NetCalibration(table.counts_per_N, table.counts_per_Nm)
    return NetCalibration.fetch(table.host, table.page_port)


def open_force_sensor(table: ForceTable) -> tuple[ForceSource, StreamReader]:
    """Returns the opened force sensor and the reader of the sensor's stream."""
    calibration = force_calibration(table)
    source = NetForce(table.host, calibration, table.port)
    return source, force_reader(calibration, SensorMounting(table.thrust, table.recoil))


def marker_camera(table: CameraTable) -> tuple[RecordedInstrument, StreamReader]:
    """Returns the camera and the reader of the camera's stream."""
    from rig.camera.instrument import MarkerCamera, MarkerLayout, camera_reader
    from rig.camera.scale import Scale
    from rig.camera.source import OpenCvSource

    source = Path(table.source) if isinstance(table.source, str) else table.source
    layout = MarkerLayout(table.markers, table.head, table.gate)
    scale = Scale(table.px_per_metre, from_below=table.from_below)
    return MarkerCamera(lambda: OpenCvSource(source, table.fps), layout), camera_reader(scale)


@contextmanager
def open_rig(port: str, table: RigTable, layout: ChamberLayout) -> Iterator[Rig]:
    """Opens the rig that a table describes. All chambers vent when the block ends or fails.

    SIGTERM and SIGHUP end the block like Ctrl-C.
    """
    from rig.manifold.serial_port import open_port

    settings = table.manifold
    limits = PressureLimits.of(settings.limits, layout, "manifold.limits of the rig file")
    sinks = ManifoldSinks(SwitchableSink(), SwitchableSink())
    with ExitStack() as stack:
        stack.enter_context(signals_as_ctrl_c())
        stack.enter_context(real_time_priority())
        instruments: dict[str, RecordedInstrument] = {}
        readers: dict[str, StreamReader] = {}
        force = None
        if table.force is not None:
            force, readers["force"] = open_force_sensor(table.force)
            instruments["force"] = force
            stack.callback(force.close)
        if table.camera is not None:
            instruments["camera"], readers["camera"] = marker_camera(table.camera)
            stack.callback(instruments["camera"].close)
        manifold = stack.enter_context(Manifold(open_port(port), *sinks))
        analogue = tuple(x.sensor() for x in table.analogue)
        timing = TrialTiming(
            settings.quiet, settings.after, settings.commands_per_second, settings.fade
        )
        yield Rig(
            manifold, sinks, limits, instruments, readers, force, analogue,
            timing, settings.pause, settings.longest_pause,
        )  # fmt: skip


@contextmanager
def signals_as_ctrl_c() -> Iterator[None]:
    """Makes SIGTERM and SIGHUP raise `KeyboardInterrupt` in the block."""

    def interrupt(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    names = [x for x in ("SIGTERM", "SIGHUP") if hasattr(signal, x)]
    before = {x: signal.signal(getattr(signal, x), interrupt) for x in names}
    try:
        yield
    finally:
        for name, handler in before.items():
            signal.signal(getattr(signal, name), handler)


def print_status(line: str) -> None:
    """Prints a line to stderr. On a terminal, the line replaces the previous status line."""
    if sys.stderr.isatty():
        width = shutil.get_terminal_size().columns - 1
        print(f"\r{line[:width]:<{width}}", end="", file=sys.stderr, flush=True)
    else:
        print(line, file=sys.stderr, flush=True)


class StatusLine:
    """Prints a run's progress: on a terminal in a single line, otherwise as a line every 2 s."""

    def __init__(self, rig: Rig, total: int, layout: ChamberLayout):
        self._layout = layout
        self._rig, self._total, self._next = rig, total, 0.0
        self._count, self._name = 0, ""

    def __call__(self, trial: str, phase: str, t: float) -> None:
        """Prints trial, phase and the time `t` [s] in the phase, if the last line is old enough."""
        now = time.monotonic()
        if trial != self._name:
            self._name, self._count = trial, self._count + 1
        if now < self._next:
            return
        self._next = now + (0.1 if sys.stderr.isatty() else 2.0)
        manifold = self._rig.manifold
        line = f"{trial} ({self._count} of {self._total}), {phase} {t:5.1f} s"
        if manifold.latest is not None:
            signed = self._layout.signed(manifold.latest.channels)
            named = zip(self._layout.actuators, signed, strict=True)
            line += f"  {' '.join(f'{x.name} {1e-3 * p:6.1f}' for x, p in named)} kPa"
        force = self._rig.force
        if force is not None:
            found = force.latest()
            line += f"  Fx {found[1][0]:6.3f} N" if found is not None else ""
            line += f"  force lost {force.health().missing}"
        line += f"  lost {manifold.lost} damaged {manifold.damaged}"
        print_status(line)

    def end(self) -> None:
        """Ends the status line on a terminal."""
        if sys.stderr.isatty():
            print(file=sys.stderr)
