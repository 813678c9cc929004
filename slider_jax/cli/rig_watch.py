"""`slider rig watch`: the calibrated model beside the rig while it runs."""

import sys
import threading
import time
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np
import tyro

from rig.live import CHANNELS_OUT, LiveStream
from slider_jax.cli.options import MaybeFolder, ModelFile, Seconds, Whole
from slider_jax.cli.rig import Port, RigFile, signals_as_ctrl_c, to_play
from slider_jax.errors import InputError

PAUSE = 0.01
"""Between looks at what has come [s]."""
SHOWN = (
    (0, "front", 1e-3, "5.1f", "kPa"),
    (2, "thrust", 1.0, "6.3f", "N"),
    (4, "tip", 1e3, "5.1f", "mm"),
)
"""Channels of the line: mean sizes, measured and by the model."""
SAYS = 2.0
"""Between lines, where there is no terminal [s]."""


def watch(
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
    may have happened: a leak, a blocked valve, a changed tail. Everything vents at the end, and on
    an alarm if there is no terminal to decide. Exit code 1 after an alarm.

    Args:
        experiment: experiment file of the robot; `slider calibrate` gives its model.
        port: serial port of the manifold.
        rig: TOML file of the rig: limits, force sensor, analogue inputs.
        model: TOML file whose [robot], [parameters] and [[effects]] override the experiment's.
        trial: whose drive is played, from 0.
        seconds: how long; by default as the trial says.
        out: folder for watch.json and watch.csv, a row a block; made if missing.
    """
    from calibration.twin import Twin
    from calibration.twin_stream import Stretch
    from slider_jax.cli.options import chosen_trials
    from slider_jax.cli.rig_settings import rig_of
    from slider_jax.experiment import load
    from slider_jax.files import staged, write_csv, write_json
    from slider_jax.provenance import input_file, versions

    loaded = load(experiment, model)
    (chosen,) = chosen_trials(loaded.trials, trial)
    if chosen.tow_speed or chosen.clamp_moves:
        print(f"{chosen.file}: its clamp moves: see to that", file=sys.stderr)
    settings = rig_of(rig)
    if settings.camera is not None:
        print("the camera is not watched: its tip is told after a trial only", file=sys.stderr)
    played = to_play(chosen, experiment)
    duration = played.duration if seconds is None else seconds
    if not duration > 0.0:
        raise InputError.value("--seconds", f"{duration:g}", "more than 0")
    print("compiling the model ...", file=sys.stderr, flush=True)
    twin = Twin.of(loaded, chosen)
    rows: list[dict[str, float]] = []
    alarms: list[dict[str, Any]] = []
    with signals_as_ctrl_c(), _Playing(port, settings, played, duration) as playing:
        said = 0.0
        while not playing.ended:
            time.sleep(PAUSE)
            live = playing.stream.take()
            if not len(live.device_s):
                continue
            stretch = Stretch(live.device_s, live.set_pressure, live.measured)
            for block in twin.feed(stretch):
                lag = 1e-9 * (time.monotonic_ns() - int(live.arrived_ns[-1]))
                rows.append(_row(block, lag))
                new = block.alarm.on and not alarms
                if new:
                    alarms.append(
                        {
                            "t_s": float(block.t[-1]),
                            "channels": block.alarm.channels,
                            "said": block.alarm.hint,
                        }
                    )
                now = time.monotonic()
                if new or now > said + (0.2 if sys.stderr.isatty() else SAYS):
                    said = now
                    _say(block, lag, playing, new)
            if alarms and not sys.stderr.isatty():
                break
    late = np.array([row["lag_s"] for row in rows])
    if len(late):
        last = rows[-1]
        print(
            f"k {last['k_s']:.4g} +- {last['k_deviation_s']:.2g} s, K_Q {last['K_Q_m3']:.4g} +- "
            f"{last['K_Q_deviation_m3']:.2g} m^3; the model was "
            f"{1e3 * np.median(late):.0f} ms late, 99 in 100 of its blocks at most "
            f"{1e3 * np.percentile(late, 99):.0f}"
        )
    for alarm in alarms:
        print(f"ALARM at {alarm['t_s']:.2f} s: {alarm['said']}")
    if out is not None and rows:
        with staged(out) as stage:
            write_csv(stage / "watch.csv", {k: np.array([r[k] for r in rows]) for k in rows[0]})
            content = {"alarms": alarms, "lost": playing.lost, "input": input_file(experiment),
                       "rig": settings.model_dump(mode="json"), "versions": versions()}  # fmt: skip
            write_json(stage / "watch.json", content)
    return 1 if alarms else 0


def _row(block, lag: float) -> dict[str, float]:
    there = np.isfinite(block.residual)
    squares = np.where(there, block.residual, 0.0) ** 2
    rms = np.sqrt(squares.sum(axis=1) / np.maximum(there.sum(axis=1), 1))
    return {
        "t_s": float(block.t[-1]),
        **{f"residual_{name}": float(x) for name, x in zip(CHANNELS_OUT, rms, strict=True)},
        "k_s": block.k.value,
        "k_deviation_s": block.k.deviation,
        "K_Q_m3": block.K_Q.value,
        "K_Q_deviation_m3": block.K_Q.deviation,
        "lost": float(block.lost.sum()),
        "compute_s": block.seconds,
        "lag_s": lag,
    }


def _say(block, lag: float, playing: "_Playing", new: bool) -> None:
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
    line = (
        f"{playing.seconds:6.1f} s  {', '.join(shown)}, k {block.k.value:.4f} s, "
        f"K_Q {block.K_Q.value:.3g} m^3, {1e3 * lag:.0f} ms late, lost {playing.lost}"
        f"{'' if block.watching else ', learning its bands'}"
    )
    if sys.stderr.isatty() and not new:
        print(f"\r{line}", end="", file=sys.stderr, flush=True)
    else:
        print(f"\n{line}" if sys.stderr.isatty() else line, file=sys.stderr, flush=True)
    if new:
        print(f"ALARM: {block.alarm.hint}", file=sys.stderr, flush=True)


class _Playing:
    """A drive played in a thread of its own, before all others; vented at the end of the block."""

    def __init__(self, port: str, settings: Any, trial: Any, duration: float):
        self._port, self._settings, self._trial = port, settings, trial
        self._duration, self._failure = duration, cast(BaseException | None, None)
        analogue = tuple(x.sensor() for x in settings.analogue)
        self.stream = LiveStream(analogue, settings.force is not None)
        self._stop = threading.Event()
        self.seconds, self.lost = 0.0, 0
        self._begun, self._force = threading.Event(), cast(Any, None)
        self._thread = threading.Thread(target=self._play, name="player", daemon=True)

    @property
    def ended(self) -> bool:
        """Whether the drive is at its end. Raises what ended it otherwise."""
        if not self._thread.is_alive() and self._failure is not None:
            raise self._failure
        return not self._thread.is_alive()

    def __enter__(self) -> "_Playing":
        self._thread.start()
        try:
            while not self._begun.wait(0.05) and self._thread.is_alive():
                pass
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._end()
        if self._failure is None or error is self._failure:
            return
        if error is None:
            raise self._failure
        error.add_note(str(self._failure))

    def _end(self) -> None:
        self._stop.set()
        self._thread.join()

    def _play(self) -> None:
        try:
            self._run()
        except _Ended:
            pass
        except BaseException as error:
            self._failure = error

    def _run(self) -> None:
        from rig.manifold import Manifold
        from rig.playing import play
        from rig.port import open_port
        from rig.priority import real_time
        from rig.safety import Limits

        limits = Limits.of(self._settings.manifold.limits)
        self._trial.drive.check(limits, self._duration)
        with real_time(), Manifold(open_port(self._port), on_reading=self.stream.reading) as m:
            self.stream.manifold = m
            m.configure(limits)
            with _forces(self._settings, self.stream) as self._force:
                m.arm()
                self.stream.clear()  # of what came before, the first block would be late
                self._begun.set()
                rate = self._settings.manifold.commands_per_second
                try:
                    play(self.stream, self._trial.drive, self._duration, rate, self._tick)
                except BaseException as error:
                    m.stop_after(error)
                    raise
                m.stop()  # before the force sensor takes its time to end

    def _tick(self, t: float) -> None:
        assert self.stream.manifold is not None
        self.seconds, self.lost = t, self.stream.manifold.lost
        if self._force is not None:
            self._force.check()
        if self._stop.is_set():
            raise _Ended


class _Ended(Exception):
    """The drive is not to go on."""


def _forces(settings: Any, stream: Any):
    """A context in which the force sensor's samples go to the stream."""
    from contextlib import contextmanager, nullcontext

    from rig import rdt
    from rig.force import Mounting
    from slider_jax.cli.rig import force_of

    if settings.force is None:
        return nullcontext()

    @contextmanager
    def running():
        source, _ = force_of(settings.force)
        mounting = Mounting(settings.force.thrust, settings.force.recoil)

        def sink(host_ns: int, datagram: bytes) -> None:
            counts = np.array(rdt.RECORD.unpack(datagram)[3:])
            thrust, recoil = mounting.thrust_and_recoil(source.calibration.wrench(counts))
            stream.force(host_ns, float(thrust), float(recoil))

        with source:
            source.start(sink)
            yield source

    return running()
