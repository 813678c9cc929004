"""`slider close-loop`: what a model lacks, from measured trials."""

import sys
import time
from pathlib import Path
from typing import Annotated

import tyro

from slider_jax.cli.options import Folder, ModelFile


def close_loop(
    experiment: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="EXPERIMENT.toml")],
    out: Folder,
    model: ModelFile = None,
) -> None:
    """Calibrate, find the residual, trace it to an effect the model lacks, add it, report.

    Writes DIR/report.html (to read), DIR/report.json (to process) and DIR/model.toml (the
    calibrated model with what was found, for `slider simulate --model`).

    Args:
        experiment: the experiment file (.toml), its measured trials beside it.
        out: folder for the results; made if missing, files of the same name are replaced.
        model: TOML file whose [robot], [parameters] and [[effects]] override the experiment's.
    """
    from calibration.closing import close_loop as close
    from calibration.next_experiment import next_experiment
    from calibration.report import model_toml, report
    from calibration.report_html import page
    from slider_jax.experiment import load
    from slider_jax.files import staged, write_json, write_text
    from slider_jax.provenance import input_file

    begun = time.monotonic()

    def say(text: str) -> None:
        print(f"{time.monotonic() - begun:5.0f} s  {text}", file=sys.stderr, flush=True)

    loaded = load(experiment, model)
    with staged(out) as stage:
        outcome = close(loaded, progress=say)
        following = next_experiment(outcome, say)
        told = report(outcome, time.monotonic() - begun, input_file(experiment), following)
        write_json(stage / "report.json", told)
        write_text(stage / "model.toml", model_toml(outcome))
        write_text(stage / "report.html", page(outcome, told))
    print(told["said"])
    print(f"Next: {following['said']}")
    print(f"report.html, report.json and model.toml are in {out}", file=sys.stderr)
