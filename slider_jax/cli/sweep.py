"""`slider sweep`: simulates a trial for a range of values of one or two experiment fields."""

import re
import shutil
import sys
from pathlib import Path
from typing import Annotated

import tyro

from slider_jax.cli.options import Folder, MaybeValue, MaybeWhole, ModelFile, Value, Whole
from slider_jax.errors import InputError


def sweep(
    experiment: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="EXPERIMENT.toml")],
    field: Annotated[str, tyro.conf.arg(metavar="FIELD")],
    start: Annotated[Value, tyro.conf.arg(name="from")],
    stop: Annotated[Value, tyro.conf.arg(name="to")],
    count: Whole,
    out: Folder,
    field2: Annotated[
        str | None, tyro.conf.arg(metavar="FIELD", help_behavior_hint="(default: none)")
    ] = None,
    start2: Annotated[MaybeValue, tyro.conf.arg(name="from2")] = None,
    stop2: Annotated[MaybeValue, tyro.conf.arg(name="to2")] = None,
    count2: MaybeWhole = None,
    model: ModelFile = None,
    trial: MaybeWhole = None,
    strides: Whole = 8,
    transient: Whole = 3,
    steps_per_stride: Whole = 300,
    swim: bool = False,
) -> None:
    """Simulates one trial for evenly spaced values of one or two fields of the experiment.

    The command writes sweep.csv, sweep.json (settings and versions) and sweep.png to DIR. Each row
    of sweep.csv contains one value (or pair of values) of the fields, and the means over the steady
    strides. An interrupted sweep resumes when you repeat the command. A complete sweep with the
    same settings is not repeated. If you start the same command several times, also on several
    computers with a shared DIR, the processes share the points of the sweep.

    Args:
        experiment: experiment file (.toml).
        field: field to vary, for example trials.0.frequency, robot.EI_tail or numerics.nodes.
        start: first value of the field, in SI units.
        stop: last value of the field, in SI units.
        count: number of evenly spaced values of the field.
        out: folder for the results; created if missing.
        field2: second field to vary, for a contour plot.
        start2: first value of the second field, in SI units (required with --field2).
        stop2: last value of the second field, in SI units (required with --field2).
        count2: number of evenly spaced values of the second field (required with --field2).
        model: TOML file. Its keys of [robot] and [parameters] replace the experiment's keys, and
            its [[effects]] are added.
        trial: number of the trial to simulate, counted from 0 (default: N if a field begins with
            trials.N, otherwise 0).
        strides: number of strides to simulate.
        transient: number of initial strides that the means exclude.
        steps_per_stride: number of time steps in a stride, a multiple of 20. If the sweep varies
            numerics.step, the command ignores this option.
        swim: simulate free swimming, and report the steady stride. The command then ignores
            --strides and --transient.
    """
    from slider_jax.cli.progress import Progress
    from slider_jax.experiment.load import load
    from slider_jax.io.files import output_folder
    from slider_jax.sweep.report import is_written, write_sweep
    from slider_jax.sweep.sweep import Axis, Sweep, run_sweep

    axes = [Axis.spaced(field, start, stop, count)]
    second = (field2, start2, stop2, count2)
    if field2 is not None and start2 is not None and stop2 is not None and count2 is not None:
        axes.append(Axis.spaced(field2, start2, stop2, count2))
    elif second != (None,) * 4:
        raise InputError("a second field needs --field2, --from2, --to2 and --count2; add all four")
    if trial is None:
        named = (re.match(r"trials\.(\d+)(\.|$)", axis.field) for axis in axes)
        trial = next((int(x[1]) for x in named if x), 0)
    given = load(experiment, model)
    if swim:
        strides, transient = 1, 0
    elif trial < len(given.trials) and given.trials[trial].support == "free":
        raise InputError(
            f"trial {trial} is free, and a sweep reports the forces on a clamp; add --swim"
        )
    task = Sweep(given, tuple(axes), trial, strides, transient, steps_per_stride, swim)
    output_folder(out)
    if is_written(task, out):
        print(
            f"{out / 'sweep.csv'} already contains all {len(task.points)} points of this sweep, "
            f"with the same settings and versions; delete {out / 'sweep.json'} to repeat the sweep",
            file=sys.stderr,
        )
        return
    try:
        with Progress(f"{len(task.points)} points", "stride") as progress:

            def begin(total, done):
                if done:
                    text = f"resuming: {done // strides} of {total // strides} chunks are complete"
                    print(text, file=sys.stderr)
                progress.begin(total, done)

            table = run_sweep(task, out, begin, progress.step)
    except KeyboardInterrupt:
        text = f"the finished part is in {out / 'partial'}; repeat the same command to resume"
        print(text, file=sys.stderr)
        raise
    except FileNotFoundError:
        if not is_written(task, out):  # by another process, which then removed the chunks
            raise
    else:
        write_sweep(task, table, out, experiment)
    shutil.rmtree(out / "partial", ignore_errors=True)
    print(f"wrote {len(task.points)} points to {out / 'sweep.csv'}", file=sys.stderr)
