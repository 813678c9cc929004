"""`slider simulate` simulates an experiment or a pressure log; `slider export` exports a shape."""

import sys
import time
from math import degrees
from pathlib import Path
from typing import Annotated, Literal

import tyro

from slider_jax.cli.commands import SIMULATE_LOG, function_of
from slider_jax.cli.options import Folder, MaybeWhole, ModelFile, Seconds, Whole, refuse_own_folder
from slider_jax.errors import InputError


def simulate(
    input: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="EXPERIMENT.toml|LOG.txt")],
    out: Folder,
    model: ModelFile = None,
    plot: bool = False,
    animate: bool = False,
    view: bool = False,
    shape: bool = False,
    step: Seconds = None,
    nodes: MaybeWhole = None,
    scheme: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = None,
    drive: Literal["set", "measured"] = "set",
) -> None:
    """Simulates all trials of an experiment, and writes the readings of the sensors.

    For each trial, the command writes a CSV file to DIR, with the name in the trial's key `file`.
    The columns are t_s, the pressure p_NAME_Pa of each chamber, thrust_N, recoil_N, tip_m, and the
    columns of [[sensors.channels]]. The command also writes DIR/summary.json with cycle means,
    settings and versions.

    Args:
        input: experiment file (.toml), or pressure log of the rig (any other suffix).
        out: folder for the results; created if missing. Existing files are replaced.
        model: TOML file. Its keys of [robot] and [parameters] replace the experiment's keys, and
            its [[effects]] are added.
        plot: also draw the simulated and measured time series and the midlines of each trial (PNG).
        animate: also draw the last two strides of each trial as a film (GIF).
        view: also write an interactive view of each trial (NAME_view.html), which a browser opens
            without a network.
        shape: also write the robot's shape at every step (NAME_shape.npz), for `slider export`.
        step: longest time step, in s; only for an experiment (default: numerics.step of the file,
            or 0.001).
        nodes: number of nodes along the robot; only for an experiment (default: numerics.nodes of
            the file, or 51).
        scheme: time scheme, sdirk2 or backward_euler; only for an experiment (default:
            numerics.scheme of the file, or sdirk2).
        drive: pressure of the log that drives the model: the set pressure (set) or the measured
            pressure (measured); only for a log.
    """
    if input.suffix.lower() != ".toml":
        options: dict[str, object] = {"--animate": animate, "--view": view, "--shape": shape}
        options |= {"--step": step, "--nodes": nodes, "--scheme": scheme}
        for name, value in options.items():
            if value:
                raise InputError(f"{name}: not allowed for a log; omit this option")
        return function_of(SIMULATE_LOG)(input, model, out, drive, plot)
    from slider_jax.channels import TIME
    from slider_jax.cli.progress import Progress
    from slider_jax.experiment.load import load
    from slider_jax.experiment.prepare import prepare
    from slider_jax.io.files import staged, write_csv, write_json
    from slider_jax.simulation.plots import plot_run
    from slider_jax.simulation.shape import saved_shape, write_shape
    from slider_jax.simulation.summary import simulation_summary, trial_summary
    from slider_jax.simulation.trial import simulate_prepared

    if drive != "set":
        raise InputError(
            "--drive measured: allowed only for a log; in an experiment, set each trial's drive_is"
        )
    experiment = load(input, model, spatial=True)
    settings = {"numerics.step": step, "numerics.nodes": nodes, "numerics.scheme": scheme}
    given = {key: value for key, value in settings.items() if value is not None}
    if given:
        experiment = experiment.with_values(given, "command line")
    refuse_own_folder(out, experiment.folder)
    # All files are checked before the first simulation.
    prepared = [prepare(experiment, trial) for trial in experiment.trials]
    channels = experiment.channels
    formats = {TIME: ".9g"} | {x.column: x.digits for x in channels.values()}
    results, with_shape = [], plot or animate or view or shape
    with staged(out) as stage:
        for each in prepared:
            started, file = time.perf_counter(), each.trial.file
            with Progress(file, "step") as progress:
                run = simulate_prepared(each, shape=with_shape, progress=progress.to)
            result = trial_summary(experiment, run)
            results.append(result)
            write_csv(stage / file, run.columns, formats)
            if plot:
                plot_run(run, result["rmse_to_measured"], stage)
            if animate:
                from slider_jax.simulation.animation import animate_run

                with Progress(file, "frame", "film of the last two strides") as progress:
                    animate_run(run, stage, progress.to)
            if view:
                from slider_jax.simulation.view import write_view

                write_view(run, stage)
            if shape:
                info = simulation_summary(experiment, [result], input, model)
                write_shape(saved_shape(run), info, stage / f"{Path(file).stem}_shape.npz")
            for line in _lines(result, channels, time.perf_counter() - started):
                print(f"{file}  {line}", file=sys.stderr)
        write_json(stage / "summary.json", simulation_summary(experiment, results, input, model))
    print(f"wrote {len(results)} trials and summary.json to {out}", file=sys.stderr)


def _lines(result, channels, seconds: float) -> list[str]:
    frequency, speed = result["frequency_Hz"], result["forward_speed_m_per_s"]
    if speed is None:
        motion = (
            f"thrust {1e3 * result['mean_thrust_N']:8.2f} mN  "
            f"recoil {1e3 * result['recoil_rms_N']:7.1f} mN rms  "
            f"tip +-{1e3 * result['tip_half_range_m']:6.2f} mm"
        )
    else:
        course = result["course_rad"]
        motion = f"forward speed {1e3 * speed:7.1f} mm/s"
        motion += "" if course is None else f"  course {degrees(course):6.1f} deg"
    lines = [
        f"{f'{frequency:4.1f} Hz' if frequency else 'recorded'}  {motion}  "
        f"({result['averaged']}; "
        f"step {1e3 * result['step_s']:.3f} ms; {seconds:.1f} s)"
    ]
    if off := result["rmse_to_measured"]:
        errors = [
            f"{x.label} {x.plot_factor * off[x.column]:.3g} {x.plot_unit}"
            for x in channels.values()
            if x.column in off
        ]
        lines.append(f"rms error: {', '.join(errors)}")
    return lines + [f"warning: {text}" for text in result["warnings"]]


def export_shape(
    input: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SHAPE.npz")],
    out: Folder,
    to: Literal["vtk", "rerun"] = "vtk",
    every: Whole = 1,
) -> None:
    """Converts a shape of `slider simulate --shape` to files for ParaView or for Rerun.

    With vtk, DIR receives one VTK file (.vtp) for each exported step, and NAME.pvd, which ParaView
    opens as a film. Each file contains the midline in the tank, the moment and the vectors tau, n
    and b of the sections at the nodes, and the force per length in the cells between the nodes.
    With rerun, DIR receives the recording NAME.rrd for the viewer Rerun: the midline in the tank,
    arrows along tau, n and b, and arrows of the forces. This format needs the package rerun-sdk.

    Args:
        input: file NAME_shape.npz of `slider simulate --shape`.
        out: folder for the results; created if missing. Existing files are replaced.
        to: format of the files.
        every: export every N-th step.
    """
    from slider_jax.io.files import staged
    from slider_jax.simulation.shape import read_shape, write_rerun, write_vtk

    if every < 1:
        raise InputError.value("--every", every, "1 or more")
    shape, _ = read_shape(input)
    with staged(out) as stage:
        if to == "vtk":
            count = write_vtk(shape, input.stem, stage, every)
            written = f"{count} VTK files and {input.stem}.pvd"
        else:
            count = write_rerun(shape, stage / f"{input.stem}.rrd", every)
            written = f"{input.stem}.rrd with {count} steps"
    print(f"wrote {written} to {out}", file=sys.stderr)
