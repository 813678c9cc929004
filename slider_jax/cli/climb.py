"""`slider climb`: the robot pinned to a wall, in air."""

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
    """Climb a wall with each trial's drive, pinned through a cross-link at alternating sides.

    In air, with weight; of the water's forces there are none. It goes on until strides repeat, and
    tells of the last 15. Without a file: the built-in robot at 2 Hz. DIR gets climb.json (all
    figures, settings, versions) and, of every trial, <its name>_climb.png, <its name>_climb.csv
    and a film, <its name>_climb.gif.

    Args:
        experiment: experiment file (.toml); its trials' towing, heaving and water have no say.
        out: folder for the results; made if missing, files of the same name are replaced.
        model: TOML file whose [robot], [parameters] and [[effects]] override the experiment's.
        trial: this trial alone, from 0.
        pin_phase: when the left end is pinned, fraction of a period after the front chamber's
            pressure is set positive; the right one is half a period later. By default the fastest
            of 16.
        link: length of the cross-link [m].
        cap: highest set pressure [Pa]; amplitudes beyond it are cut.
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
    print(f"climb.json, picture, film and strides of each trial are in {out}", file=sys.stderr)
