"""`slider rig watch`: the calibrated model beside the rig while it runs."""

import shutil
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
from rig.cli.shared import Port, RigFile, planned_trial, signals_as_ctrl_c, with_force_counts
from rig.recording.table import format_value
from rig.scheduling import raise_priority
from rig.trial.live_stream import CHANNELS_OUT, LiveReadings
from slider_jax.channels import BUILT_IN
from slider_jax.cli.options import MaybeFolder, ModelFile, Seconds, Whole, chosen_trials
from slider_jax.errors import InputError
from slider_jax.experiment.load import load
from slider_jax.io.files import input_file, staged, versions, write_csv, write_json

PAUSE = 0.01
"""Between looks at what has come [s]."""
SHOWN = (
    (0, "front", 1e-3, "5.1f", "kPa"),
    (1, "rear", 1e-3, "5.1f", "kPa"),
    (2, "thrust", 1.0, "6.3f", "N"),
    (4, "tip", 1e3, "5.1f", "mm"),
)
"""Channels of the line: mean sizes, measured and by the model."""
SAYS = 2.0
"""Between lines, where there is no terminal [s]."""


def rig_watch(
    experiment: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="EXPERIMENT.toml")],
    port: Port,
    rig: RigFile = None,
    model: ModelFile = None,
    trial: Whole = 0,
    seconds: Seconds = None,
    out: MaybeFolder = None,
) -> int:
    """Play a trial's drive, and run the calibrated model beside it on the rig's readings.

    Told are k and K_Q as they are followed on line, how far measurement and model are apart on each
    channel, and how late the model is. An alarm says when the residual leaves its band, and what
    may have happened: a leak, a blocked valve, a changed tail. What was wrong while the bands were
    learned is not judged; where the model did not fit then, that is told. Everything vents at the
    end, and on an alarm if there is no terminal to decide. Exit code 1 after an alarm.

    Args:
        experiment: experiment file of the robot; `slider calibrate` gives its model.
        port: serial port of the manifold.
        rig: TOML file of the rig: limits, force sensor, analogue inputs.
        model: TOML file whose [robot], [parameters] and [[effects]] override the experiment's.
        trial: whose drive is played, from 0.
        seconds: how long; by default as the trial says.
        out: folder for watch.json and watch.csv, a row a block; made if missing. Written also
            where it was stopped, or a port was lost.
    """
    loaded = load(experiment, model)
    (chosen,) = chosen_trials(loaded.trials, trial)
    if chosen.tow_speed or chosen.clamp_moves:
        print(f"{chosen.file}: its clamp moves: see to that", file=sys.stderr)
    settings = with_force_counts(load_rig(rig))
    if settings.camera is not None:
        print("the camera is not watched: its tip is told after a trial only", file=sys.stderr)
    played = planned_trial(chosen, experiment)
    duration = played.duration if seconds is None else seconds
    if not duration > 0.0:
        raise InputError.value("--seconds", f"{duration:g}", "more than 0")
    print("compiling the model ...", file=sys.stderr, flush=True)
    twin = Twin.of(loaded, chosen)
    raise_priority()
    if duration < twin.judges_after:
        print(
            f"the trial ends after {duration:g} s, before the bands are learned: nothing will be "
            f"judged; give --seconds {4.0 * twin.judges_after:.0f} or more",
            file=sys.stderr,
        )
    told = WatchLog()
    playing = DrivePlayer(port, settings, played, duration)
    try:
        with signals_as_ctrl_c(), playing:
            while not playing.ended:
                time.sleep(PAUSE)
                live = playing.stream.take()
                if not len(live.device_s):
                    continue
                stretch = Samples(live.device_s, live.set_pressure, live.measured)
                for block in twin.feed(stretch):
                    told.take(block, _arrived(block, live), playing.lost)
                told.take_misfits(twin.misfits)
                if told.alarms and not sys.stderr.isatty():
                    told.ended = "by the alarm"
                    break
    except BaseException as error:  # whatever it is: what was watched is told first
        told.ended = "\n".join([str(error) or "stopped", *getattr(error, "__notes__", ())])
        raise
    finally:
        told.sum_up()
        if out is not None and told.rows:
            source = {"input": input_file(experiment), "rig": settings.model_dump(mode="json")}
            told.write(out, {"lost": playing.lost, **source, "versions": versions()})
    return 1 if told.alarms else 0


@dataclass
class WatchLog:
    """What is told of the blocks, at once and at the end. Times are since the first reading [s]."""

    rows: list[dict[str, float]] = field(default_factory=list)
    alarms: list[dict[str, Any]] = field(default_factory=list)
    begun: float = np.nan
    """The manifold's time of the first reading [s]."""
    ended: str = "whole"
    judged: bool = False
    """Whether the bands were learned."""
    misfits: dict[str, tuple[float, float]] = field(default_factory=dict)
    """`Twin.misfits`."""
    _said: float = 0.0
    _on: bool = False

    def take(self, block: TwinBlock, arrived_ns: int, lost: int) -> None:
        """A block, and when its last reading arrived."""
        if not self.rows:
            self.begun = float(block.t[0])
        lag = 1e-9 * (time.monotonic_ns() - arrived_ns)
        self.rows.append(_row(block, self.begun, lag))
        self.judged = block.watching
        new, self._on = block.alarm.on and not self._on, block.alarm.on
        if new:
            at, channels = self.rows[-1]["t_s"], block.alarm.channels
            self.alarms.append({"t_s": at, "channels": channels, "said": block.alarm.hint})
        now = time.monotonic()
        if new or now > self._said + (0.2 if sys.stderr.isatty() else SAYS):
            self._said = now
            _say(block, self.rows[-1], lost, new)

    def take_misfits(self, misfits: dict[str, tuple[float, float]]) -> None:
        """How the model fitted while the bands were learned; said when it is known."""
        if misfits and not self.misfits:
            self.misfits = misfits
            print(f"\n{self._misfitting()}", file=sys.stderr, flush=True)

    def _misfitting(self) -> str:
        names = dict(zip(BUILT_IN, CHANNELS_OUT, strict=True))
        found = ", ".join(
            f"{name} by {format_value(names[name], rms)} ({100.0 * share:.0f} % of the model's)"
            for name, (rms, share) in self.misfits.items()
        )
        return (
            f"the model was off while its bands were learned, {found}: what was wrong by then is "
            "not judged; see `slider rig check`, or calibrate anew"
        )

    def sum_up(self) -> None:
        """Prints how it ended."""
        if self.rows:
            last, late = self.rows[-1], np.array([row["lag_s"] for row in self.rows])
            print(
                f"k {last['k_s']:.4g} +- {last['k_deviation_s']:.2g} s, K_Q {last['K_Q_m3']:.4g} "
                f"+- {last['K_Q_deviation_m3']:.2g} m^3; the model was "
                f"{1e3 * np.median(late):.0f} ms late, 99 in 100 of its blocks at most "
                f"{1e3 * np.percentile(late, 99):.0f}"
            )
        for alarm in self.alarms:
            print(f"ALARM at {alarm['t_s']:.2f} s: {alarm['said']}")
        if self.judged and not self.alarms:
            print(f"no alarm, but {self._misfitting()}" if self.misfits else "no alarm")

    def write(self, out: Path, beside: dict[str, Any]) -> None:
        """watch.csv and watch.json, with what is to be told `beside`."""
        with staged(out) as stage:
            columns = {k: np.array([r[k] for r in self.rows]) for k in self.rows[0]}
            write_csv(stage / "watch.csv", columns)
            told = {"alarms": self.alarms, "t_0_device_s": self.begun, "ended": self.ended}
            shares = {name: {"rms": rms, "share": x} for name, (rms, x) in self.misfits.items()}
            told["misfits"] = shares
            write_json(stage / "watch.json", told | beside)


def _arrived(block: TwinBlock, live: LiveReadings) -> int:
    """When the reading that made a block complete arrived [ns]."""
    complete = np.searchsorted(live.device_s, block.t[-1] - 1e-3)
    return int(live.arrived_ns[min(complete, len(live.arrived_ns) - 1)])


def _row(block: TwinBlock, begun: float, lag: float) -> dict[str, float]:
    there = np.isfinite(block.residual)
    squares = np.where(there, block.residual, 0.0) ** 2
    rms = np.sqrt(squares.sum(axis=1) / np.maximum(there.sum(axis=1), 1))
    return {
        "t_s": float(block.t[-1]) - begun,
        **{f"residual_{name}": float(x) for name, x in zip(CHANNELS_OUT, rms, strict=True)},
        "k_s": block.k.value,
        "k_deviation_s": block.k.deviation,
        "K_Q_m3": block.K_Q.value,
        "K_Q_deviation_m3": block.K_Q.deviation,
        "lost": float(block.lost.sum()),
        "compute_s": block.seconds,
        "lag_s": lag,
    }


def _say(block: TwinBlock, row: dict[str, float], lost: int, new: bool) -> None:
    there = np.isfinite(block.measured)
    count = np.maximum(there.sum(axis=1), 1)
    model, measured = (
        np.where(there, np.abs(x), 0.0).sum(axis=1) / count for x in (block.model, block.measured)
    )
    shown = [
        f"{name} {factor * measured[i]:{form}} (model {factor * model[i]:{form}}) {unit}"
        for i, name, factor, form, unit in SHOWN
        if there[i].any()
    ]
    state = "ALARM stands, " if block.alarm.on else "" if block.watching else "learning its bands, "
    line = (
        f"{row['t_s']:6.1f} s  {state}{', '.join(shown)}, k {block.k.value:.4f} s, "
        f"K_Q {block.K_Q.value:.3g} m^3, {1e3 * row['lag_s']:.0f} ms late, lost {lost}"
    )
    if not sys.stderr.isatty():
        print(line, file=sys.stderr, flush=True)
    else:
        width = shutil.get_terminal_size().columns - 1
        print(f"\r{line[:width]:<{width}}", end="", file=sys.stderr, flush=True)
    if new:
        goes_on = "\nit goes on; Ctrl-C vents" if sys.stderr.isatty() else ""
        print(f"\nALARM: {block.alarm.hint}{goes_on}", file=sys.stderr, flush=True)
