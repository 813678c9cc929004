"""`slider transition`: simulates a robot that swims to a wall and climbs out of the water."""

import sys
from pathlib import Path

from slider_jax.cli.options import Folder, MaybeExperiment, ModelFile, refuse_own_folder


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
    from slider_jax.transition.crossing import simulate_transition, transition_record
    from slider_jax.transition.example import example_crosser

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
        write_csv(stage / "transition.csv", report.course_columns(run))
        report.plot_transition(run, stage / "transition.png")
        with Progress("transition", "frame", "film") as progress:
            report.film_transition(run, Path(stage / "transition.gif"), progress.to)
    print("\n".join(report.transition_summary(run)))
    print(f"wrote transition.json, .csv, .png and .gif to {out}", file=sys.stderr)
