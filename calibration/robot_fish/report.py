"""Writes the predictions of a robot fish as speeds.json, as text and as report.html."""

from typing import Any

import numpy as np

from calibration.reporting.html import embedded_png, render_page
from calibration.robot_fish.markers import RELIABLE
from calibration.robot_fish.predict import (
    CALIBRATED_ON,
    DRIVE,
    WATER,
    FishCalibration,
    RunPrediction,
    Swum,
    prediction_record,
)
from slider_jax.io.figures import new_figure
from slider_jax.io.files import provenance

PREDICTORS = {
    "kinematic drive": lambda x: x.kinematic.speed,
    "beat frequency alone": lambda x: x.tendons.speed,
    "before: the stated mass and inertia of the head": lambda x: x.before.speed,
    "straight line through the two runs": lambda x: x.line,
    "proportional to the beat": lambda x: x.proportional,
}
"""Predicted speed [m/s] of each predictor."""


def speed_errors(runs: list[RunPrediction]) -> dict[str, float]:
    """Returns the mean absolute error [m/s] of each predictor."""
    return {
        name: float(np.mean([abs(speed(x) - x.measured.speed) for x in runs]))
        for name, speed in PREDICTORS.items()
    }


def unseen(runs: list[RunPrediction]) -> list[RunPrediction]:
    """Returns the runs on which nothing was calibrated."""
    return [x for x in runs if x.run.name not in CALIBRATED_ON]


def speed_sentence(runs: list[RunPrediction]) -> str:
    """Returns the mean absolute errors of both drives in one sentence."""
    errors = speed_errors(unseen(runs) or runs)
    kind = "runs outside the fit" if unseen(runs) else "runs of the fit"
    kinematic, beat = (errors[name] for name in list(PREDICTORS)[:2])
    return (
        f"The mean absolute error of the speed over {len(unseen(runs) or runs)} {kind} is "
        f"{kinematic:.4f} m/s with the kinematic drive and {beat:.4f} m/s from the beat alone."
    )


def fish_speeds_record(runs: list[RunPrediction]) -> dict[str, Any]:
    """Returns the content of speeds.json."""
    return {x.run.name: prediction_record(x) for x in runs}


def settings_record(
    runs: list[RunPrediction], fitted: FishCalibration, settings: Any, sources: list[dict[str, Any]]
) -> dict[str, Any]:
    """Returns the content of result.json: errors, parameters, settings, inputs and versions."""
    return {
        "said": speed_sentence(runs),
        "mean_absolute_error_m_per_s": {
            "all": speed_errors(runs),
            "unseen": speed_errors(unseen(runs)) if unseen(runs) else None,
        },
        "parameters": {k: float(v) for k, v in vars(fitted.parameters).items()},
        "fitted": [*WATER, *DRIVE],
        "calibrated_on": fitted.runs,
        "settings": {
            "steps_per_beat": settings.steps_per_beat, "beats": settings.beats,
            "kept_beats": settings.kept, "tail_cells": settings.numerics.tail_cells,
            "body_cells": settings.numerics.body_cells,
        },
        "input": sources,
        **provenance(),
    }  # fmt: skip


def fish_speeds_table(runs: list[RunPrediction]) -> str:
    """Returns the speeds as a text table."""
    lines = [f"{'run':<10}{'beat Hz':>8}{'measured':>10}{'kinematic':>10}{'beat':>10}{'line':>10}"]
    for x in runs:
        speeds = (x.measured.speed, x.kinematic.speed, x.tendons.speed, x.line)
        lines.append(f"{x.run.name:<10}{x.run.beat:8.4f}" + "".join(f"{u:10.4f}" for u in speeds))
    for name, error in speed_errors(runs).items():
        lines.append(f"mean absolute error, {name}: {error:.4f} m/s")
    return "\n".join(lines)


UNITS = {
    "C": "-", "yaw_inertia": "kg m^2", "sway_mass": "kg", "sway_exponent": "-", "pull": "-",
    "hinge": "N m/rad",
}  # fmt: skip
"""Units of the parameters."""


def _speed_rows(runs: list[RunPrediction]) -> list[list[str]]:
    return [
        [x.run.name, f"{x.run.beat:.4f}", f"{x.measured.speed:.4f}"]
        + [f"{speed(x):.4f}" for speed in PREDICTORS.values()]
        for x in runs
    ]


def _recoil_rows(runs: list[RunPrediction]) -> list[list[str]]:
    rows = []
    for x in runs:
        for name, y in (("measured", x.measured), ("kinematic", x.kinematic), ("beat", x.tendons)):
            sway = [f"{1e3 * abs(y.motion.sway[k]):.1f}" for k in RELIABLE]
            rows.append([x.run.name, name, *sway, f"{np.degrees(abs(y.motion.yaw)):.2f}"])
    return rows


def _speed_figure(runs: list[RunPrediction]):
    figure, axes = new_figure(figsize=(7.0, 4.5))
    beats = [x.run.beat for x in runs]
    styles = ("o-", "s-", "x:", "--", "-.")
    for (name, speed), style in zip(PREDICTORS.items(), styles, strict=True):
        axes.plot(beats, [speed(x) for x in runs], style, label=name)
    axes.plot(beats, [x.measured.speed for x in runs], "k*", markersize=11, label="measured")
    axes.set_xlabel("beat frequency (Hz)")
    axes.set_ylabel("speed (m/s)")
    axes.legend(fontsize=8)
    return figure


def _recoil_figure(runs: list[RunPrediction]):
    figure, axes = new_figure(1, 2, figsize=(9.0, 4.0))
    beats = [x.run.beat for x in runs]

    def draw(ax, value, labels):
        kinds = (("k*", "measured"), ("o-", "kinematic"), ("x:", "before"))
        for (style, label), kind in zip(kinds, labels, strict=True):
            ax.plot(beats, [value(kind(x)) for x in runs], style, label=label)
        ax.set_xlabel("beat frequency (Hz)")

    kinds: list = [lambda x: x.measured, lambda x: x.kinematic, lambda x: x.before]

    def head(y: Swum) -> float:
        return 1e3 * abs(y.motion.sway[0])

    def yaw(y: Swum) -> float:
        return float(np.degrees(abs(y.motion.yaw)))

    draw(axes[0], head, kinds)
    axes[0].set_ylabel("sway of marker 0 (mm)")
    draw(axes[1], yaw, kinds)
    axes[1].set_ylabel("yaw of the head (deg)")
    axes[1].legend(fontsize=8)
    return figure


def fish_page(runs: list[RunPrediction], fitted: FishCalibration, record: dict[str, Any]) -> str:
    """Returns report.html; `record` is the content of result.json."""
    errors = record["mean_absolute_error_m_per_s"]
    return render_page(
        "robot_fish.html",
        title="Speed of a tendon-driven robot fish",
        record=record,
        predictors=list(PREDICTORS),
        speeds=_speed_rows(runs),
        recoil=_recoil_rows(runs),
        errors=[
            [name, f"{error:.4f}", f"{errors['unseen'][name]:.4f}" if errors["unseen"] else "-"]
            for name, error in errors["all"].items()
        ],
        parameters=[
            [k, f"{float(v):.4g}", UNITS[k], "fitted" if k in record["fitted"] else "chosen"]
            for k, v in vars(fitted.parameters).items()
        ],
        speed_png=embedded_png(_speed_figure(runs)),
        recoil_png=embedded_png(_recoil_figure(runs)),
    )
