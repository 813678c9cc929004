"""`slider warm-up`: compiles the programs of the everyday commands before they are needed."""

import io
import os
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import tyro

from slider_jax.errors import InputError

Experiments = Annotated[
    tyro.conf.Positional[tuple[Path, ...]],
    tyro.conf.arg(metavar="EXPERIMENT.toml", help_behavior_hint=""),
]
Part = Literal["simulate", "swim", "climb", "calibrate", "demo", "close-loop"]
Parts = Annotated[
    tuple[Part, ...], tyro.conf.arg(help_behavior_hint="(default: all except close-loop)")
]


LONGEST, TRIALS = 2.0, 5
"""Longest duration [s] of the trials of the parts calibrate and close-loop, and their number."""


def warm_up(
    experiments: Experiments = (), parts: Parts = ("simulate", "swim", "climb", "calibrate", "demo")
) -> None:
    """Compiles the programs of the everyday commands, so that their first call is faster.

    Each part runs one command in a temporary folder, which is deleted. The compiled programs stay
    in the cache folder. A robot with another mesh, other effects or another number of chambers has
    other programs, so give the experiments that you will simulate or calibrate. The command takes
    about three minutes, and the part close-loop takes eight minutes; it is needed once for each
    version. If you stop the command, the finished programs are kept; repeat the command to compile
    the others.

    Args:
        experiments: experiment files (.toml). The part simulate uses all files. The parts calibrate
            and close-loop simulate short trials of the first file as data. The other parts use
            built-in inputs (default: the built-in robot for all parts).
        parts: commands whose programs are compiled.
    """
    from slider_jax.cli.progress import timed_printer
    from slider_jax.programs import all_programs_kept, compiled_programs

    if os.environ.get("SLIDER_CACHE") == "off":
        raise InputError("SLIDER_CACHE: given 'off', so no program is kept; unset the variable")
    say, rows = timed_printer(), []
    with tempfile.TemporaryDirectory() as folder, all_programs_kept():
        work = _work(Path(folder), experiments)
        for number, part in enumerate(parts):
            say(f"{part} ({number + 1} of {len(parts)}) ...")
            started, before = time.monotonic(), compiled_programs()
            try:
                with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
                    work[part]()
            except KeyboardInterrupt:
                print("finished programs are kept; repeat the command", file=sys.stderr)
                raise
            new = len(compiled_programs() - before)
            rows.append(f"{part:<12}{new:>12}{time.monotonic() - started:>10.1f}")
    print("\n".join([f"{'part':<12}{'new programs':>12}{'time (s)':>10}", *rows]))
    print("the next call of each command loads these programs", file=sys.stderr)


def _work(folder: Path, experiments: tuple[Path, ...]) -> dict[str, Callable[[], object]]:
    """Returns the call of each part."""
    from calibration.cli.calibrate_tank import tank
    from calibration.cli.close_loop import close_loop
    from slider_jax.cli.demo import demo
    from slider_jax.cli.simulate import simulate
    from slider_jax.cli.swim import climb, swim

    def simulated() -> None:
        for number, path in enumerate(experiments or (_measured(folder),)):
            for plot in (False, True):  # pictures need another program
                simulate(path, folder / f"simulated_{number}", plot=plot)

    measured = partial(_measured, folder, *experiments[:1])
    return {
        "simulate": simulated,
        "swim": lambda: swim(out=folder / "swim"),
        "climb": lambda: climb(out=folder / "climb"),
        "calibrate": lambda: tank(measured(), out=folder / "calibrated"),
        "demo": lambda: demo(folder / "demo"),
        "close-loop": lambda: close_loop((measured(),), out=folder / "loop"),
    }


def _measured(folder: Path, experiment: Path | None = None) -> Path:
    """Writes short simulated trials of the experiment, or of the built-in robot, with noise.

    Returns the path of their experiment file.
    """
    from calibration.measurements import synthetic
    from slider_jax.experiment.load import load
    from slider_jax.optimise.design_space import to_toml

    out = folder / "measured"
    if experiment is None:
        mesh = {"nodes": 51, "step": 1e-3}
        truth = synthetic.Truth(synthetic.START, {})
        return synthetic.write_tank(
            out, truth, synthetic.random_trials(0, 4, 0.5), 0, numerics=mesh
        )
    given = load(experiment)
    trials = [
        x.model_copy(update={"duration": min(x.duration, LONGEST)})
        for x in given.trials
        if x.waveform != "recorded"
    ][:TRIALS]
    if not trials:
        raise InputError(
            f"{experiment}: all drives are recordings; give an experiment with square, sine or "
            "trapezoid waves, or choose --parts without calibrate and close-loop"
        )
    out.mkdir(exist_ok=True)
    short = given.model_copy(update={"trials": tuple(trials)})
    synthetic.write_trials(out, short, 0, synthetic.Sensors())
    (out / "experiment.toml").write_text(to_toml(short), encoding="utf-8")
    return out / "experiment.toml"
