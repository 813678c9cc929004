"""`slider calibrate`: parameters from measured trials."""

import sys
import time
from pathlib import Path
from typing import Annotated

import tyro

from slider_jax.cli.options import Folder, ModelFile

Names = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")]


def tank(
    experiment: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="EXPERIMENT.toml")],
    out: Folder,
    also: Names = (),
    channels: Names = ("p_front", "p_rear", "thrust", "recoil", "tip"),
    model: ModelFile = None,
) -> None:
    """Identify C_d, m_a, k and K_Q from measured trials, with intervals.

    Writes DIR/calibration.json (values, 95 % intervals, correlations, errors before and after
    beside the floor) and DIR/model.toml (for `slider simulate --model`).

    Args:
        experiment: the experiment file (.toml), its measured trials beside it.
        out: folder for the results; made if missing, files of the same name are replaced.
        also: effects whose parameters are identified too; slider effects lists them.
        channels: what is fitted, of p_front, p_rear, thrust, recoil, tip.
        model: TOML file whose [robot], [parameters] and [[effects]] override the experiment's.
    """
    from calibration.identify import content, identify, model_file, table
    from slider_jax.experiment import load
    from slider_jax.files import staged, write_json, write_text
    from slider_jax.provenance import input_file

    begun = time.monotonic()

    def say(text: str) -> None:
        print(f"{time.monotonic() - begun:5.0f} s  {text}", file=sys.stderr, flush=True)

    with staged(out) as stage:
        found = identify(load(experiment, model), also, channels, say)
        write_json(stage / "calibration.json", content(found, input_file(experiment)))
        write_text(stage / "model.toml", model_file(found))
    print(table(found))
    print(f"calibration.json and model.toml are in {out}", file=sys.stderr)
