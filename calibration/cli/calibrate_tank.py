"""`slider calibrate`: parameters from measured trials."""

import sys
import time
from pathlib import Path
from typing import Annotated

import tyro

from slider_jax.cli.options import Folder, ModelFile

Method = Annotated[str, tyro.conf.arg(metavar="METHOD")]
Names = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")]


def tank(
    experiment: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="EXPERIMENT.toml")],
    out: Folder,
    also: Names = (),
    channels: Names = ("p_front", "p_rear", "thrust", "recoil", "tip"),
    per_frequency: bool = False,
    each: Names = ("C_d", "m_a"),
    method: Method = "auto",
    model: ModelFile = None,
) -> None:
    """Identify C_d, m_a, k and K_Q from measured trials, with intervals.

    Writes DIR/calibration.json (values, 95 % intervals, correlations, errors before and after
    beside the floor) and DIR/model.toml (for `slider simulate --model`). A parameter that the data
    do not determine gets no value, but the trial that would determine it. With --per-frequency,
    C_d and m_a by drive frequency too, compared with constant values and with the paper's ramp on
    frequencies that were left out, in DIR/per_frequency.csv and .png.

    Args:
        experiment: the experiment file (.toml), its measured trials beside it.
        out: folder for the results; made if missing, files of the same name are replaced.
        also: effects whose parameters are identified too; slider effects lists them.
        channels: what is fitted, of p_front, p_rear, thrust, recoil, tip.
        per_frequency: let C_d and m_a differ by drive frequency, and say whether they do.
        each: what may differ by frequency, of the parameters that are identified.
        method: auto, lm (Levenberg-Marquardt) or lbfgs (from 12 parameters on).
        model: TOML file whose [robot], [parameters] and [[effects]] override the experiment's.
    """
    from calibration.identification import identify as single
    from calibration.identification.per_frequency import check_labels
    from calibration.model.extended import parameters
    from slider_jax.experiment.load import load
    from slider_jax.io.files import input_file, staged, tentative_folder, write_json, write_text

    begun = time.monotonic()

    def say(text: str) -> None:
        print(f"{time.monotonic() - begun:5.0f} s  {text}", file=sys.stderr, flush=True)

    loaded = load(experiment, model)
    single.check_names(also, channels, method)
    if per_frequency:
        check_labels(each, parameters(also))
    with tentative_folder(out):
        found = single.identify_parameters(loaded, also, channels, say, method=method)
        with staged(out) as stage:
            content, text = (
                single.identification_record(found, input_file(experiment)),
                single.identified_model(found),
            )
            told = [single.parameter_table(found)]
            if per_frequency:
                more, text, table = _by_frequency(found, each, say, stage)
                text = f"# {found.doubt}\n{text}" if found.doubt else text
                content |= {"per_frequency": more}
                told += ["", table]
            write_json(stage / "calibration.json", content)
            write_text(stage / "model.toml", text)
    print("\n".join(told))
    print(f"calibration.json and model.toml are in {out}", file=sys.stderr)


def _by_frequency(found, each, say, stage: Path):
    """What the comparison adds to calibration.json, its model file, and its table in words."""
    from calibration.identification import per_frequency_report as report
    from calibration.identification.per_frequency import compare
    from slider_jax.io.files import write_csv

    compared = compare(found.experiment, found.entries, found.problem, found.fit, each, say)
    write_csv(stage / "per_frequency.csv", report.frequency_columns(compared, each))
    report.picture(compared, each, stage / "per_frequency.png")
    return (
        report.per_frequency_record(compared),
        report.per_frequency_model(compared, each),
        report.per_frequency_table(compared),
    )
