"""`slider swim`: the robot set free."""

import sys
from pathlib import Path

from slider_jax.cli.options import (
    Folder,
    MaybeExperiment,
    MaybeWhole,
    ModelFile,
    chosen_trials,
    refuse_own_folder,
)


def swim(
    experiment: MaybeExperiment = None,
    *,
    out: Folder,
    model: ModelFile = None,
    trial: MaybeWhole = None,
) -> None:
    """Swim freely with each trial's drive: from rest until the stride repeats, and as a root.

    Without a file: the paper's optimum, with form drag at the head that was calibrated on its
    measured speed. DIR gets swim.json (all figures, settings, versions) and, of every trial,
    <its name>_swim.png and <its name>_swim.csv, one steady stride.

    Args:
        experiment: experiment file (.toml); its trials' towing and heaving have no say.
        out: folder for the results; made if missing, files of the same name are replaced.
        model: TOML file whose [robot], [parameters] and [[effects]] override the experiment's.
        trial: this trial alone, from 0.
    """
    from slider_jax.io.files import input_file, staged, versions, write_csv, write_json
    from slider_jax.swimming.free_swim import (
        free_swimmer,
        simulate_free_swim as swim_freely,
        swim_record,
    )
    from slider_jax.swimming.paper_optimum import PUBLISHED, given_or, optimum
    from slider_jax.swimming.report import plot_swim, stride_columns, swim_summary, swim_table

    given = given_or(optimum, experiment, model)
    trials = chosen_trials(given.trials, trial)
    published = PUBLISHED if experiment is None else {}
    if experiment is not None:
        refuse_own_folder(out, given.folder)
    for x in trials:  # all that cannot be swum is told before anything is computed
        free_swimmer(given, x)
    rows = []
    with staged(out) as stage:
        for x in trials:
            name = Path(x.file).stem

            def say(text: str, name: str = name) -> None:
                print(f"{name}: {text} ...", file=sys.stderr, flush=True)

            found = swim_freely(given, x, say)
            rows.append(swim_record(found))
            write_csv(stage / f"{name}_swim.csv", stride_columns(found))
            plot_swim(found, stage / f"{name}_swim.png")
            print(f"{name}: {x.waveform} {x.frequency:g} Hz")
            print(swim_table(rows[-1], published))
            print("\n".join(swim_summary(found)))
        content = {
            "swims": rows,
            "published": {name: x._asdict() for name, x in published.items()},
            "experiment": given.model_dump(),
            "inputs": [input_file(p) for p in (experiment, model) if p is not None],
            "versions": versions(),
        }
        write_json(stage / "swim.json", content)
    print(f"swim.json, a picture and a stride of each trial are in {out}", file=sys.stderr)
