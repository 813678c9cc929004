"""`slider calibrate`: identifies parameters from measured trials."""

import sys
from pathlib import Path
from typing import Annotated

import tyro

from slider_jax.cli.options import Folder, ModelFile, Names
from slider_jax.cli.progress import timed_printer
from slider_jax.errors import refuse_unknown

Method = Annotated[str, tyro.conf.arg(metavar="METHOD")]


def tank(
    experiment: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="EXPERIMENT.toml")],
    out: Folder,
    also: Names = (),
    channels: Names = (),
    per_frequency: bool = False,
    each: Names = ("C_d", "m_a"),
    method: Method = "auto",
    model: ModelFile = None,
) -> None:
    """Identifies C_d, m_a, k and K_Q with 95 % intervals from measured trials.

    The command writes DIR/calibration.json (values, intervals, correlations, errors and noise
    floors) and DIR/model.toml (for `slider simulate --model`). If the data do not determine a
    parameter, the command gives no value and proposes a trial that would determine the parameter.
    With --per-frequency, the command also identifies C_d and m_a for every drive frequency, and
    compares these values with constant values and with the paper's ramp by cross-validation.
    The results of the comparison are in DIR/per_frequency.csv and DIR/per_frequency.png.

    Args:
        experiment: experiment file (.toml). Its measured trials must be in the same folder.
        out: folder for the results; created if missing. Files of the same name are replaced.
        also: names of effects whose parameters are also identified (default: none). The command
            slider effects lists the names.
        channels: names of the channels to fit (default: all channels of the experiment).
        per_frequency: compare separate values for every drive frequency with constant values.
        each: names of the parameters that may differ between frequencies (default: C_d m_a).
        method: lm (Gauss-Newton with step shortening), lbfgs (L-BFGS), or auto (lbfgs for 12
            parameters or more, otherwise lm).
        model: TOML file. Its keys of [robot] and [parameters] replace the experiment's keys, and
            its [[effects]] are added.
    """
    from calibration.identification.identify import (
        check_names,
        identification_record,
        identified_model,
        identify_parameters,
        parameter_table,
    )
    from calibration.model.extended import model_parameters
    from slider_jax.experiment.load import load
    from slider_jax.io.files import input_file, staged, tentative_folder, write_json, write_text

    progress = timed_printer()
    loaded = load(experiment, model)
    check_names(also, channels, method, loaded.channels)
    if per_frequency:
        refuse_unknown("--each", each, [p.label for p in model_parameters(also)])
    with tentative_folder(out):
        found = identify_parameters(loaded, also, channels, progress, method=method)
        record = identification_record(found, input_file(experiment))
        model_text = identified_model(found)
        tables = [parameter_table(found)]
        with staged(out) as stage:
            if per_frequency:
                comparison, model_text, table = _by_frequency(found, each, progress, stage)
                model_text = f"# {found.doubt}\n{model_text}" if found.doubt else model_text
                record |= {"per_frequency": comparison}
                tables += ["", table]
            write_json(stage / "calibration.json", record)
            write_text(stage / "model.toml", model_text)
    print("\n".join(tables))
    print(f"calibration.json and model.toml are in {out}", file=sys.stderr)


def _by_frequency(found, each, progress, stage: Path):
    """Writes the comparison's CSV file and figure; returns JSON record, model file and table."""
    from calibration.identification import per_frequency_report as report
    from calibration.identification.per_frequency import compare_ties
    from slider_jax.io.files import write_csv

    compared = compare_ties(
        found.experiment, found.entries, found.problem, found.fit, each, progress
    )
    write_csv(stage / "per_frequency.csv", report.frequency_columns(compared, each))
    report.plot_by_frequency(compared, each, stage / "per_frequency.png")
    return (
        report.per_frequency_record(compared),
        report.per_frequency_model(compared, each),
        report.per_frequency_table(compared),
    )
