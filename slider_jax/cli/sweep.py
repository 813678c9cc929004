"""`slider sweep`: one or two fields of an experiment over ranges."""

import shutil
import sys
from pathlib import Path
from typing import Annotated

import tyro

from slider_jax.cli.options import Folder, MaybeValue, MaybeWhole, ModelFile, Value, Whole
from slider_jax.errors import InputError

_FIELD = tyro.conf.arg(metavar="FIELD")


def sweep(
    experiment: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="EXPERIMENT.toml")],
    field: Annotated[str, _FIELD],
    start: Annotated[Value, tyro.conf.arg(name="from")],
    stop: Annotated[Value, tyro.conf.arg(name="to")],
    count: Whole,
    out: Folder,
    field2: Annotated[str | None, _FIELD] = None,
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
    """Simulate one trial over one or two ranges and write a table and a plot.

    DIR gets sweep.csv (a row a member: means of the steady strides), sweep.json (settings and
    versions) and sweep.png. A run that was stopped goes on when its command is given again, and one
    that is there is not computed again.

    Args:
        experiment: the experiment file (.toml).
        field: the number to sweep, e.g. trials.0.frequency, robot.EI_tail, numerics.nodes.
        start: its first value, SI.
        stop: its last value, SI.
        count: how many values, evenly spaced.
        out: folder for the results; made if missing.
        field2: a second number, for a contour plot.
        start2: its first value, SI.
        stop2: its last value, SI.
        count2: how many values of the second.
        model: TOML file whose [robot], [parameters] and [[effects]] override the experiment's.
        trial: which trial is run, from 0; by default that of a field trials.N..., else 0.
        strides: strides run.
        transient: strides left out of the means.
        steps_per_stride: time steps of a stride, a multiple of 20; follows a swept numerics.step.
        swim: set the robot free, and tell what its steady stride comes to; --strides and
            --transient have no say.
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
        raise InputError("a second field needs all of --field2, --from2, --to2, --count2")
    task = Sweep(
        load(experiment, model),
        tuple(axes),
        _trial(axes) if trial is None else trial,
        strides,
        transient,
        steps_per_stride,
        swim,
    )
    output_folder(out)
    if is_written(task, out):
        print(
            f"{out / 'sweep.csv'} holds the {len(task.points)} members of this sweep already, with "
            f"the same settings and versions; to run it again, delete {out / 'sweep.json'}",
            file=sys.stderr,
        )
        return
    try:
        with Progress(f"{len(task.points)} members", "stride") as progress:

            def begin(total, done):
                if done:
                    said = f"taking up {done // strides} of {total // strides} chunks done before"
                    print(said, file=sys.stderr)
                progress.begin(total, done)

            table = run_sweep(task, out, begin, progress.step)
    except KeyboardInterrupt:
        print(
            f"finished chunks are kept in {out / 'partial'}; give the same command again to go on",
            file=sys.stderr,
        )
        raise
    write_sweep(task, table, out, experiment)
    shutil.rmtree(out / "partial")
    print(f"{len(task.points)} members are in {out / 'sweep.csv'}", file=sys.stderr)


def _trial(axes) -> int:
    """The trial that a field names."""
    for axis in axes:
        parts = axis.field.split(".")
        if parts[0] == "trials" and len(parts) > 1 and parts[1].isdigit():
            return int(parts[1])
    return 0
