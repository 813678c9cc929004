"""`slider climb`: simulates climbing a wall in air."""

import sys
from pathlib import Path

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
    """Simulate climbing a wall with each trial's drive.

    The ends of a cross-link at the head are pinned alternately. Climbing is simulated in air:
    weight acts, hydrodynamic forces and the carriage clamp are omitted. The simulation runs until
    strides repeat and reports the last 15. It writes climb.json (all values, settings and versions)
    to DIR, and for each trial NAME: NAME_climb.png, NAME_climb.csv and the film NAME_climb.gif.

    Args:
        experiment: experiment file (.toml); towing, heaving and water of its trials are ignored
            (default: the built-in robot at 2 Hz).
        out: folder for the results; created if missing. Existing files are replaced.
        model: TOML file whose [robot], [parameters] and [[effects]] override the experiment's.
        trial: number of the only trial to run, counted from 0 (default: all trials).
        pin_phase: delay from the front chamber's positive pressure step to pinning the left end,
            as a fraction of a period; the right end is pinned half a period later (default: the
            fastest of 16 phases).
        link: length of the cross-link, in m.
        cap: highest set pressure, in Pa; larger amplitudes are reduced to it.
    """
    from slider_jax.cli.progress import Progress
    from slider_jax.climbing.climb import climb_record, simulate_climb as climb_wall
    from slider_jax.climbing.report import (
        climb_summary,
        climb_table,
        film,
        plot_climb,
        series_columns,
    )
    from slider_jax.io.files import input_file, staged, versions, write_csv, write_json
    from slider_jax.swimming.gait import stride_frequency
    from slider_jax.swimming.paper_optimum import example_climber, given_or

    if pin_phase is not None and not -1.0 <= pin_phase <= 1.0:
        raise InputError.value("--pin-phase", f"{pin_phase:g}", "-1 to 1, of a period")
    if not 0.005 <= link <= 0.2:
        raise InputError.value("--link", f"{link:g}", "0.005 to 0.2 m")
    if not 1e3 <= cap <= 2e6:
        raise InputError.value("--cap", f"{cap:g}", "1e3 to 2e6 Pa", "pascal, not kPa or psi")
    given = given_or(example_climber, experiment, model)
    trials = chosen_trials(given.trials, trial)
    if experiment is not None:
        refuse_own_folder(out, given.folder)
    for x in trials:
        stride_frequency(x)
    rows = []
    with staged(out) as stage:
        for x in trials:
            name = Path(x.file).stem

            def say(text: str, name: str = name) -> None:
                print(f"{name}: {text} ...", file=sys.stderr, flush=True)

            run = climb_wall(given, x, pin_phase, link, cap, say)
            rows.append(climb_record(run))
            write_csv(stage / f"{name}_climb.csv", series_columns(run))
            plot_climb(run, stage / f"{name}_climb.png")
            with Progress(name, "frame", "film of the last strides") as progress:
                film(run, stage / f"{name}_climb.gif", progress.to)
            print(f"{name}: {x.waveform} {x.frequency:g} Hz")
            print(climb_table(rows[-1]))
            print("\n".join(climb_summary(run)))
        content = {
            "climbs": rows,
            "experiment": given.model_dump(),
            "inputs": [input_file(p) for p in (experiment, model) if p is not None],
            "versions": versions(),
        }
        write_json(stage / "climb.json", content)
    print(
        f"wrote climb.json, and a figure, film and table of each trial, to {out}", file=sys.stderr
    )
