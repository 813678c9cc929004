"""`slider swim`: simulates free swimming."""

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
    """Simulate free swimming with each trial's drive and report the steady speed.

    The steady speed is computed twice: by root finding, and by swimming from rest until strides
    repeat. The command writes swim.json (all values, settings and versions) to DIR. For each trial
    NAME it also writes NAME_swim.png and NAME_swim.csv, which contain one steady stride.

    Args:
        experiment: experiment file (.toml); towing and heaving of its trials are ignored (default:
            the paper's optimum, with form drag at the head calibrated on its measured speed).
        out: folder for the results; created if missing. Existing files are replaced.
        model: TOML file whose [robot], [parameters] and [[effects]] override the experiment's.
        trial: number of the only trial to run, counted from 0 (default: all trials).
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
    for x in trials:  # report every invalid trial before the first computation
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
    print(f"wrote swim.json, and a figure and a table of each trial, to {out}", file=sys.stderr)
