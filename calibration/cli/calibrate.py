"""`slider calibrate manifold`: identifies the pressure lag from the rig's pressure logs."""

import sys
from pathlib import Path
from typing import Annotated, Any

import tyro

from calibration.pressure_logs.identify import PAPER_K, Identification, identify_lag, rms
from calibration.pressure_logs.lag import PLAUSIBLE
from calibration.pressure_logs.read import PSI_AT_ZERO, PSI_PER_COUNT, read_log
from calibration.pressure_logs.text import describe_lag, lag_verdict
from slider_jax.cli.options import Folder, Pictures
from slider_jax.cli.progress import Progress
from slider_jax.errors import InputError
from slider_jax.io.files import input_file, staged, versions, write_json, write_text
from slider_jax.io.toml import significant, toml_text

DEFINITIONS = {
    "rmse": "root mean square of the residual, measured minus simulated pressure. The simulated "
    "pressure starts at the first measured sample and then depends on the command only",
    "pooled rmse": "root of the mean of all logs' mean square residuals; logs have equal weight",
    "settled": "value computed without the first cycle of each log",
    "over samples": "root mean square over the samples of all logs; long logs have more weight",
    "k": "least-squares estimate by the Levenberg-Marquardt method in log k. The method starts at "
    f"the lowest local minimum of a scan from {PLAUSIBLE[0]:g} to {PLAUSIBLE[1]:g} s. The common k "
    "of all logs minimises the pooled rmse",
    "interval": "95 % interval from the sandwich variance of log k. The effective number of "
    "samples is samples / (1 + 2 c), where c sums the residual's autocorrelation up to its first "
    "zero. The interval of the common k uses one cluster per log, and Student's t with logs - 1 "
    "degrees of freedom. The interval k_within is valid for these logs only",
    "widening": "width of the interval, divided by its width for independent samples",
    "floor": "standard deviation of the white noise of the measured pressure, estimated from "
    "fourth differences; this value does not include drift and slow noise",
    "shape": "shape of the residual with the k fitted to this log, over whole cycles after the "
    "first cycle",
}


def manifold(
    logs: Annotated[
        tyro.conf.Positional[tuple[Path, ...]],
        tyro.conf.arg(metavar="LOG.txt ...", help_behavior_hint="(required)"),
    ],
    out: Folder,
    plot: Pictures = True,
) -> None:
    """Identifies the lag's time constant k from pressure logs, for each log and for all logs.

    The command writes DIR/manifold.json, pictures, and DIR/model.toml (for `slider simulate
    --model`). The command prints whether one k explains all logs, and a table of the fits.

    Args:
        logs: one or more pressure logs (.txt) in the format of the published firmware.
        out: folder for the results; created if missing. Files of the same name are replaced.
        plot: draw the pictures (PNG); --no-plot omits them.
    """
    refuse_same_names(logs)
    records = sorted((read_log(path) for path in logs), key=lambda log: log.frequency)
    for log in records:
        for finding in log.findings:
            print(f"{log.path.name}: {finding}", file=sys.stderr)
    print(f"fitting {len(records)} logs ...", file=sys.stderr)
    found = identify_lag(records)
    lines = describe_lag(found)
    with staged(out) as stage:
        write_json(stage / "manifold.json", lag_record(found, lines))
        write_text(stage / "model.toml", lag_model_toml(found))
        if plot:
            _draw(found, stage)
    print("\n".join([lines[0], "", lag_table(found), "", *lines[1:]]))
    print(f"manifold.json, model.toml{' and pictures' if plot else ''} are in {out}")


def refuse_same_names(logs: tuple[Path, ...]) -> None:
    """Raises `InputError` if no log is given, or if two logs have the same name."""
    if not logs:
        raise InputError("LOG.txt: no file given; give one or more pressure logs")
    seen: dict[str, Path] = {}
    for path in logs:
        if path.stem in seen:
            raise InputError(
                f"{path}: same name as {seen[path.stem]}; names of logs must differ; rename one of "
                "the logs, or give each log once"
            )
        seen[path.stem] = path


def _draw(found: Identification, folder: Path) -> None:
    from calibration.pressure_logs.plots import plot_k, plot_log, plot_phase, plot_rate

    plot_k(found, PAPER_K, folder / "k_by_frequency.png")
    plot_phase(found, folder / "residual_by_phase.png")
    plot_rate(found, folder / "residual_by_rate.png")
    with Progress("pictures", "log", "drawing") as progress:
        for number, result in enumerate(found.logs, start=1):
            plot_log(result, PAPER_K, folder / f"{result.log.path.stem}.png")
            progress.to(number, len(found.logs))


def lag_record(found: Identification, lines: list[str]) -> dict[str, Any]:
    """Returns the content of manifold.json, with k in s and pressures in psi."""
    return {
        "pooled": {
            "k": found.k._asdict(),
            "k_within": found.within._asdict(),
            "k_is_fixed": found.k.fixed,
            "rmse_before_psi": found.pooled_rmse("before"),
            "rmse_after_psi": found.pooled_rmse("pooled"),
            "rmse_each_its_own_psi": found.pooled_rmse("after"),
            "rmse_before_settled_psi": found.pooled_rmse("before", settled=True),
            "rmse_after_settled_psi": found.pooled_rmse("pooled", settled=True),
            "rmse_each_its_own_settled_psi": found.pooled_rmse("after", settled=True),
            "rmse_before_over_samples_psi": found.sample_rmse("before"),
            "rmse_after_over_samples_psi": found.sample_rmse("pooled"),
            "floor_psi": found.floor,
        },
        "logs": [
            {
                "input": input_file(x.log.path),
                "frequency_Hz": x.log.frequency,
                "samples": len(x.log.t),
                "duration_s": x.log.t[-1],
                "k": x.k._asdict(),
                "k_is_fixed": x.fixed,
                "rmse_before_psi": rms(x.before),
                "rmse_after_psi": rms(x.after),
                "rmse_pooled_k_psi": rms(x.pooled),
                "rmse_held_psi": x.rms_held,
                "floor_psi": x.shape.floor,
                "shape": x.shape._asdict() | {"measured": x.shape.measured._asdict()},
                "findings": [str(finding) for finding in x.log.findings],
            }
            for x in found.logs
        ],
        "said": lines,
        "definitions": DEFINITIONS,
        "settings": {
            "reference_k_s": PAPER_K,
            "searched_k_s": PLAUSIBLE,
            "psi_per_count": PSI_PER_COUNT,
            "psi_at_zero_counts": PSI_AT_ZERO,
        },
        "seed": None,
        "versions": versions(),
    }


def lag_model_toml(found: Identification) -> str:
    """Returns a model file with the common k of all logs."""
    k = found.k
    names = ", ".join(x.log.path.name for x in found.logs)
    comment = (
        f"{lag_verdict(found)}\n"
        f"slider calibrate manifold identified this pressure lag from {len(found.logs)} logs: "
        f"{names}\nThe 95 % interval of k is {k.low:.4f} to {k.high:.4f} s. The RMSE is "
        f"{found.pooled_rmse('before'):.2f} psi with the paper's k and "
        f"{found.pooled_rmse('pooled'):.2f} psi with this k. Sensor noise: {found.floor:.2f} psi"
    )
    return toml_text({"parameters": {"k": significant(k.value, 6)}}, comment, {"k": "s"})


def lag_table(found: Identification) -> str:
    """Returns the result as a table, with one line for each log and one line for all logs."""
    lines = [
        f"{'log':<16}{'Hz':>7}{'samples':>9}{'k ms':>7}{'95 % interval':>16}{'widening':>10}"
        f"{'before':>9}{'after':>8}{'common k':>10}{'noise':>7}   (RMSE in psi)"
    ]
    for x in found.logs:
        own = f"{1e3 * x.k.value:7.0f}" if x.fixed else f"{'-':>7}"
        lines.append(
            f"{x.log.path.name[:15]:<16}{x.log.frequency:7.4g}{len(x.log.t):9d}{own}"
            f"{1e3 * x.k.low:8.0f}-{1e3 * x.k.high:<7.0f}{x.k.widening:10.1f}"
            f"{rms(x.before):9.2f}{rms(x.after):8.2f}{rms(x.pooled):10.2f}{x.shape.floor:7.2f}"
        )
    k = found.k
    lines.append(
        f"{'all':<16}{'':>7}{sum(len(x.log.t) for x in found.logs):9d}{1e3 * k.value:7.0f}"
        f"{1e3 * k.low:8.0f}-{1e3 * k.high:<7.0f}{k.widening:10.1f}"
        f"{found.pooled_rmse('before'):9.2f}{found.pooled_rmse('after'):8.2f}"
        f"{found.pooled_rmse('pooled'):10.2f}{found.floor:7.2f}"
    )
    return "\n".join(lines)
