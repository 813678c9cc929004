"""`slider swim`, `slider climb` and `slider transition`: swimming, climbing, and between both."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from slider_jax.cli.options import (
    Folder,
    MaybeExperiment,
    MaybeValue,
    MaybeWhole,
    ModelFile,
    Value,
    chosen_trials,
    refuse_own_folder,
)
from slider_jax.errors import InputError


def swim(
    experiment: MaybeExperiment = None,
    *,
    out: Folder,
    model: ModelFile = None,
    trial: MaybeWhole = None,
) -> None:
    """Simulates free swimming with each trial's drive and reports the steady speed.

    The command computes the steady speed twice: by root finding, and by a simulation from rest
    until the speed is steady. An experiment with dimension = 3 is only simulated from rest. DIR
    then contains swim.json (all values, settings and versions). For each trial NAME, the files
    NAME_swim.png and NAME_swim.csv describe one steady stride.

    Args:
        experiment: experiment file (.toml); towing and heaving of the trials are ignored (default:
            the paper's optimum; with the head's form drag, it has the measured speed).
        out: folder for the results; created if missing. Existing files are replaced.
        model: TOML file. Its keys of [robot] and [parameters] replace the experiment's keys, and
            its [[effects]] are added.
        trial: number of the trial to simulate, counted from 0 (default: all trials).
    """
    from slider_jax.swimming.free_swim import free_swimmer, simulate_free_swim, swim_record
    from slider_jax.swimming.paper_optimum import PUBLISHED, given_or, optimum
    from slider_jax.swimming.report import plot_swim, stride_columns, swim_summary, swim_table

    given = given_or(optimum, experiment, model, spatial=True)
    if given.dimension == 3:
        _swim_in_space(given, (experiment, model), out, trial)
        return
    published = PUBLISHED if experiment is None else {}

    def simulated(x, stem: str, say: Callable[[str], None]):
        found = simulate_free_swim(given, x, say)
        row = swim_record(found)
        plot_swim(found, Path(f"{stem}.png"))
        return row, stride_columns(found), [swim_table(row, published), *swim_summary(found)]

    values = {"published": {name: x._asdict() for name, x in published.items()}}
    inputs = (experiment, model)
    _run("swim", given, inputs, out, trial, lambda x: free_swimmer(given, x), simulated, values)


def _swim_in_space(
    given: Any, inputs: tuple[Path | None, Path | None], out: Path, trial: int | None
) -> None:
    from slider_jax.cli.progress import Progress
    from slider_jax.swimming import report
    from slider_jax.swimming.free_swim import free_swimmer
    from slider_jax.swimming.swim_in_space import simulate_swim_in_space, spatial_swim_record

    def simulated(x, stem: str, say: Callable[[str], None]):
        say("compiling and swimming from rest")
        with Progress(Path(x.file).stem, "stride", "until strides repeat") as progress:
            found = simulate_swim_in_space(given, x, progress.to)
        row = spatial_swim_record(found)
        report.plot_spatial_swim(found, Path(f"{stem}.png"))
        text = report.spatial_swim_summary(found, row)
        return row, report.spatial_stride_columns(found), text

    _run("swim", given, inputs, out, trial, lambda x: free_swimmer(given, x), simulated, {})


def climb(
    experiment: MaybeExperiment = None,
    *,
    out: Folder,
    model: ModelFile = None,
    trial: MaybeWhole = None,
    pin_phase: MaybeValue = None,
    link: Value = 0.03,
    cap: Value = 172.3e3,
) -> None:
    """Simulates climbing a wall with each trial's drive.

    The ends of a cross-link at the head are pinned alternately. Climbing is simulated in air:
    hydrodynamic forces and the carriage clamp are omitted. The simulation ends when the motion
    is periodic. The command reports means over the last 15 strides and writes climb.json (all
    values, settings and versions) to DIR. For each trial NAME, DIR also contains NAME_climb.png,
    NAME_climb.csv and the film NAME_climb.gif.

    Args:
        experiment: experiment file (.toml); towing, heaving and water are ignored (default: the
            built-in robot at 2 Hz).
        out: folder for the results; created if missing. Existing files are replaced.
        model: TOML file. Its keys of [robot] and [parameters] replace the experiment's keys, and
            its [[effects]] are added.
        trial: number of the trial to simulate, counted from 0 (default: all trials).
        pin_phase: delay from the positive step of the first chamber's set pressure until the left
            end is pinned, as a fraction of a period. The right end is pinned half a period later
            (default: of 16 phases, the phase with the fastest climb).
        link: length of the cross-link, in m.
        cap: highest set pressure, in Pa; larger amplitudes are reduced to this value.
    """
    from slider_jax.cli.progress import Progress
    from slider_jax.climbing import report
    from slider_jax.climbing.climb import climb_record, simulate_climb
    from slider_jax.swimming.gait import stride_frequency
    from slider_jax.swimming.paper_optimum import example_climber, given_or

    if pin_phase is not None and not -1.0 <= pin_phase <= 1.0:
        raise InputError.value("--pin-phase", f"{pin_phase:g}", "-1 to 1, a fraction of a period")
    if not 0.005 <= link <= 0.2:
        raise InputError.value("--link", f"{link:g}", "0.005 to 0.2 m")
    if not 1e3 <= cap <= 2e6:
        raise InputError.value("--cap", f"{cap:g}", "1e3 to 2e6 Pa", "pascal, not kPa or psi")
    given = given_or(example_climber, experiment, model)

    def simulated(x, stem: str, say: Callable[[str], None]):
        run = simulate_climb(given, x, pin_phase, link, cap, say)
        row = climb_record(run)
        report.plot_climb(run, Path(f"{stem}.png"))
        with Progress(Path(x.file).stem, "frame", "film of the last strides") as progress:
            report.film(run, Path(f"{stem}.gif"), progress.to)
        text = [report.climb_table(row), *report.climb_summary(run)]
        return row, report.series_columns(run), text

    _run("climb", given, (experiment, model), out, trial, stride_frequency, simulated, {})


def transition(experiment: MaybeExperiment = None, *, out: Folder, model: ModelFile = None) -> None:
    """Simulates a robot that starts submerged, swims to a wall and climbs out of the water.

    The table [transition] of the experiment gives the start, the wall, the spines and the schedule
    of the gait. The forces of the water act on the wet part of the robot, and weight and buoyancy
    act throughout. The simulation ends at the goal or after the longest time. DIR then contains
    transition.json (times, energies, where the robot fails and why, settings and versions),
    transition.csv, transition.png and the film transition.gif.

    Args:
        experiment: experiment file (.toml) with a table [transition] (default: the built-in robot
            with an optimised schedule).
        out: folder for the results; created if missing. Existing files are replaced.
        model: TOML file. Its keys of [robot] and [parameters] replace the experiment's keys, and
            its [[effects]] are added.
    """
    from slider_jax.cli.progress import Progress
    from slider_jax.io.files import input_files, provenance, staged, write_csv, write_json
    from slider_jax.swimming.paper_optimum import given_or
    from slider_jax.transition import report
    from slider_jax.transition.example import example_crosser
    from slider_jax.transition.run import simulate_transition, transition_record

    given = given_or(example_crosser, experiment, model)
    if experiment is not None:
        refuse_own_folder(out, given.folder)
    with Progress("transition", "second", "until the goal") as progress:
        run = simulate_transition(given, progress.to)
    with staged(out) as stage:
        content = {
            **transition_record(run),
            "experiment": given.model_dump(),
            "inputs": input_files(experiment, model),
            **provenance(),
        }
        write_json(stage / "transition.json", content)
        write_csv(stage / "transition.csv", report.crossing_columns(run))
        report.plot_transition(run, stage / "transition.png")
        with Progress("transition", "frame", "film") as progress:
            report.film_transition(run, Path(stage / "transition.gif"), progress.to)
    print("\n".join(report.transition_summary(run)))
    print(f"wrote transition.json, .csv, .png and .gif to {out}", file=sys.stderr)


def _run(
    command: str,
    given,
    inputs: tuple[Path | None, Path | None],
    out: Path,
    trial: int | None,
    check: Callable[..., object],
    simulated: Callable[..., tuple[dict[str, Any], dict[str, Any], list[str]]],
    values: dict[str, Any],
) -> None:
    """Simulates and reports trials of the experiment `given`, read from the files `inputs`.

    `check` raises `InputError` for an invalid trial. `simulated(trial, stem, say)` draws files
    whose paths begin with `stem`, and returns the trial's record, CSV columns and printed lines.
    """
    from slider_jax.io.files import input_files, provenance, staged, write_csv, write_json

    trials = chosen_trials(given.trials, trial)
    if inputs[0] is not None:
        refuse_own_folder(out, given.folder)
    for x in trials:  # check all trials before the first simulation
        check(x)
    rows = []
    with staged(out) as stage:
        for x in trials:
            name = Path(x.file).stem

            def say(text: str, name: str = name) -> None:
                print(f"{name}: {text} ...", file=sys.stderr, flush=True)

            row, columns, text = simulated(x, f"{stage / name}_{command}", say)
            rows.append(row)
            write_csv(stage / f"{name}_{command}.csv", columns)
            print("\n".join([f"{name}: {x.waveform} {x.frequency:g} Hz", *text]))
        content = {
            f"{command}s": rows,
            **values,
            "experiment": given.model_dump(),
            "inputs": input_files(*inputs),
            **provenance(),
        }
        write_json(stage / f"{command}.json", content)
    print(f"wrote {command}.json and the files of each trial to {out}", file=sys.stderr)
