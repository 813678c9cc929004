"""`slider rig watch`: runs the calibrated model beside the rig and raises alarms."""

import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from calibration.twin.stream import Samples
from calibration.twin.twin import Twin, TwinBlock
from rig.cli.playback import DrivePlayer
from rig.cli.settings import load_rig
from rig.cli.shared import (
    Port,
    RigFile,
    layout_of,
    planned_trial,
    print_status,
    signals_as_ctrl_c,
    warn_of_moving_clamp,
    with_force_counts,
)
from rig.manifold.limits import PressureLimits
from rig.recording.table import format_value
from rig.scheduling import raise_priority
from rig.trial.live_stream import LiveReadings
from slider_jax.channels import Channel
from slider_jax.cli.options import MaybeFolder, ModelFile, Seconds, Whole, chosen_trials
from slider_jax.errors import InputError
from slider_jax.experiment.load import load
from slider_jax.io.files import input_file, provenance, staged, write_csv, write_json

POLL_INTERVAL = 0.01
"""Time between queries of the live stream [s]."""
STATUS_UNITS = {"Pa": (1e-3, "5.1f", "kPa"), "N": (1.0, "6.3f", "N"), "m": (1e3, "5.1f", "mm")}
"""Factor, format and unit of the values in the status line, by the unit of the channel."""
NOT_SHOWN = ("recoil",)
"""Channels that the status line omits."""
LINE_INTERVAL = 2.0
"""Time between status lines if stderr is not a terminal [s]."""


def rig_watch(
    experiment: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="EXPERIMENT.toml")],
    port: Port,
    rig: RigFile = None,
    model: ModelFile = None,
    trial: Whole = 0,
    seconds: Seconds = None,
    out: MaybeFolder = None,
) -> int:
    """Plays a trial's drive, and compares the readings with the calibrated model in real time.

    The command prints estimates of k (time constant of the pressure) and K_Q (moment of a chamber
    per unit pressure), measured and modelled values, and the model's delay. In about the first
    eight seconds, the command learns the normal band of each channel's residual. A fault in this
    time raises no alarm, but a message reports a poor fit. If a residual leaves the band later, an
    alarm names possible causes: a leak, a blocked valve, a changed tail. All chambers vent at the
    end, and after an alarm if stderr is not a terminal. The exit code is 1 after an alarm.

    Args:
        experiment: experiment file of the robot.
        port: serial port of the manifold; `slider rig ports` lists all serial ports.
        rig: TOML file of the rig: limits, command rate and sensors.
        model: TOML file, for example from `slider calibrate`. Its keys of [robot] and [parameters]
            replace the experiment's keys, and its [[effects]] are added.
        trial: number of the trial whose drive is played, counted from 0.
        seconds: duration of the drive, in s (default: the trial's duration).
        out: folder for watch.json and watch.csv, with one row per block of readings; created if
            missing. The files are also written after Ctrl-C or an error (default: no files).
    """
    loaded = load(experiment, model)
    (chosen,) = chosen_trials(loaded.trials, trial)
    warn_of_moving_clamp(chosen)
    settings = with_force_counts(load_rig(rig))
    if settings.camera is not None:
        print("the camera is not used: it yields the tip only after a trial", file=sys.stderr)
    layout = layout_of(loaded, experiment)
    played = planned_trial(chosen, layout, experiment)
    played.check(PressureLimits.of(settings.manifold.limits, layout, f"{rig}: manifold.limits"))
    duration = played.duration if seconds is None else seconds
    if not duration > 0.0:
        raise InputError.value("--seconds", f"{duration:g}", "more than 0")
    print("compiling the model ...", file=sys.stderr, flush=True)
    twin = Twin.of(loaded, chosen)
    raise_priority()
    if duration < twin.judges_after:
        print(
            f"the trial ends after {duration:g} s, before the bands are learned: no alarm is "
            f"possible; give --seconds {4.0 * twin.judges_after:.0f} or more",
            file=sys.stderr,
        )
    playing = DrivePlayer(port, settings, played, duration)
    log = WatchLog(twin.channels.members)
    try:
        with signals_as_ctrl_c(), playing:
            while not playing.ended:
                time.sleep(POLL_INTERVAL)
                live = playing.stream.take()
                if not len(live.device_s):
                    continue
                samples = Samples(live.device_s, live.set_pressure, live.measured)
                for block in twin.feed(samples):
                    log.add(block, _arrived(block, live), playing.lost)
                log.add_misfits(twin.misfits)
                if log.alarms and not sys.stderr.isatty():
                    log.ended = "by the alarm"
                    break
    except BaseException as error:  # also Ctrl-C; `finally` writes the reason to the log
        log.ended = "\n".join([str(error) or "stopped", *getattr(error, "__notes__", ())])
        raise
    finally:
        log.print_summary()
        if out is not None and log.rows:
            source = {"input": input_file(experiment), "rig": settings.model_dump(mode="json")}
            log.write(out, {"lost": playing.lost, **source, **provenance()})
    return 1 if log.alarms else 0


@dataclass
class WatchLog:
    """Prints and stores the twin's blocks of readings. Times [s] count from the first reading."""

    channels: tuple[Channel, ...]
    """The channels of the readings, in their order."""
    rows: list[dict[str, float]] = field(default_factory=list)
    alarms: list[dict[str, Any]] = field(default_factory=list)
    begun: float = np.nan
    """Time of the first reading on the manifold's clock [s]."""
    ended: str = "whole"
    """End of the run: "whole", "by the alarm", "stopped" or an error's text."""
    judged: bool = False
    """Whether the watch has learned the bands of the residuals."""
    misfits: dict[str, tuple[float, float]] = field(default_factory=dict)
    """For each channel with a poor fit: rms residual, and rms residual / rms of the model."""
    _printed: float = 0.0
    _on: bool = False

    def add(self, block: TwinBlock, arrived_ns: int, lost: int) -> None:
        """Adds a block that was complete at host time `arrived_ns`. `lost` counts lost readings."""
        if not self.rows:
            self.begun = float(block.t[0])
        lag = 1e-9 * (time.monotonic_ns() - arrived_ns)
        self.rows.append(_row(block, self.channels, self.begun, lag))
        self.judged = block.watching
        new, self._on = block.alarm.on and not self._on, block.alarm.on
        if new:
            at, channels = self.rows[-1]["t_s"], block.alarm.channels
            self.alarms.append({"t_s": at, "channels": channels, "said": block.alarm.hint})
        now = time.monotonic()
        if new or now > self._printed + (0.2 if sys.stderr.isatty() else LINE_INTERVAL):
            self._printed = now
            _print_line(block, self.channels, self.rows[-1], lost, new)

    def add_misfits(self, misfits: dict[str, tuple[float, float]]) -> None:
        """Stores and prints, once, the misfits from the time in which the bands were learned."""
        if misfits and not self.misfits:
            self.misfits = misfits
            print(f"\n{self._misfit_text()}", file=sys.stderr, flush=True)

    def _misfit_text(self) -> str:
        columns = {x.name: x.column for x in self.channels}
        found = ", ".join(
            f"{name} {format_value(columns[name], rms)}, {100.0 * share:.0f} % of the modelled rms"
            for name, (rms, share) in self.misfits.items()
        )
        return (
            f"the model did not fit while the bands were learned (rms residuals: {found}); a "
            "fault from that time raises no alarm; run `slider rig check`, or calibrate again"
        )

    def print_summary(self) -> None:
        """Prints the final estimates, the model's delay and the alarms."""
        if self.rows:
            last, late = self.rows[-1], np.array([row["lag_s"] for row in self.rows])
            print(
                f"k {last['k_s']:.4g} +- {last['k_deviation_s']:.2g} s, K_Q {last['K_Q_m3']:.4g} "
                f"+- {last['K_Q_deviation_m3']:.2g} m^3; the model's median "
                f"delay was {1e3 * np.median(late):.0f} ms; 99 % of the blocks of readings were at "
                f"most {1e3 * np.percentile(late, 99):.0f} ms late"
            )
        for alarm in self.alarms:
            print(f"ALARM at {alarm['t_s']:.2f} s: {alarm['said']}")
        if self.judged and not self.alarms:
            print(f"no alarm, but {self._misfit_text()}" if self.misfits else "no alarm")

    def write(self, out: Path, beside: dict[str, Any]) -> None:
        """Writes watch.csv and watch.json. The entries of `beside` are added to watch.json."""
        with staged(out, measured=True) as stage:
            columns = {k: np.array([r[k] for r in self.rows]) for k in self.rows[0]}
            write_csv(stage / "watch.csv", columns)
            content = {"alarms": self.alarms, "t_0_device_s": self.begun, "ended": self.ended}
            shares = {name: {"rms": rms, "share": x} for name, (rms, x) in self.misfits.items()}
            content["misfits"] = shares
            write_json(stage / "watch.json", content | beside)


def _arrived(block: TwinBlock, live: LiveReadings) -> int:
    """Returns the arrival time of the reading that completed a block [ns]."""
    complete = np.searchsorted(live.device_s, block.t[-1] - 1e-3)
    return int(live.arrived_ns[min(complete, len(live.arrived_ns) - 1)])


def _row(
    block: TwinBlock, channels: tuple[Channel, ...], begun: float, lag: float
) -> dict[str, float]:
    valid = np.isfinite(block.residual)
    squares = np.where(valid, block.residual, 0.0) ** 2
    rms = np.sqrt(squares.sum(axis=1) / np.maximum(valid.sum(axis=1), 1))
    return {
        "t_s": float(block.t[-1]) - begun,
        **{f"residual_{x.column}": float(y) for x, y in zip(channels, rms, strict=True)},
        "k_s": block.k.value,
        "k_deviation_s": block.k.deviation,
        "K_Q_m3": block.K_Q.value,
        "K_Q_deviation_m3": block.K_Q.deviation,
        "lost": float(block.lost.sum()),
        "compute_s": block.seconds,
        "lag_s": lag,
    }


def _print_line(
    block: TwinBlock, channels: tuple[Channel, ...], row: dict[str, float], lost: int, new: bool
) -> None:
    valid = np.isfinite(block.measured)
    count = np.maximum(valid.sum(axis=1), 1)
    model, measured = (
        np.where(valid, np.abs(x), 0.0).sum(axis=1) / count for x in (block.model, block.measured)
    )
    shown = []
    for i, x in enumerate(channels):
        if valid[i].any() and x.name not in NOT_SHOWN:
            factor, form, unit = STATUS_UNITS[x.unit]
            shown.append(
                f"{x.name.removeprefix('p_')} {factor * measured[i]:{form}} "
                f"(model {factor * model[i]:{form}}) {unit}"
            )
    state = "ALARM, " if block.alarm.on else "" if block.watching else "learning the bands, "
    line = (
        f"{row['t_s']:6.1f} s  {state}{', '.join(shown)}, k {block.k.value:.4f} s, "
        f"K_Q {block.K_Q.value:.3g} m^3, {1e3 * row['lag_s']:.0f} ms late, lost {lost}"
    )
    print_status(line)
    if new:
        advice = "\nthe drive continues; press Ctrl-C to vent" if sys.stderr.isatty() else ""
        print(f"\nALARM: {block.alarm.hint}{advice}", file=sys.stderr, flush=True)
