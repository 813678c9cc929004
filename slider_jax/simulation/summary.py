"""Summarises simulated trials: cycle means, warnings, settings and inputs."""

from pathlib import Path
from typing import Any

import numpy as np

from slider_jax.experiment.load import Experiment, drag_and_added_mass
from slider_jax.io.files import input_file, provenance
from slider_jax.simulation.trial import TrialRun

DEFINITIONS = {
    "mean_thrust_N": "mean thrust in the averaging window; positive forward, along the clamp; "
    "null for a free robot, because no clamp acts on it; the same holds for thrust_std_N and "
    "recoil_rms_N",
    "thrust_std_N": "standard deviation of the strides' mean thrusts; null for one stride",
    "recoil_rms_N": "root mean square of the lateral force on the clamp in the averaging window",
    "tip_half_range_m": "half of the range of the tip's lateral position in the averaging window; "
    "null for a free robot, which may turn",
    "forward_speed_m_per_s": "distance between the head's positions in the tank at the start and "
    "at the end of the averaging window, divided by the time; negative if the tail leads; null for "
    "a clamped robot",
    "course_rad": "direction of this displacement, positive to the left of the x axis; null for a "
    "clamped robot, and for a speed below 0.1 mm/s",
    "averaged": "the averaging window: the last half of the trial's whole strides, at least one "
    "stride. The window is the whole trial if the trial is shorter than a stride, and the second "
    "half of the trial if the drive is recorded",
    "periodic": "whether the last two strides agree: the mean thrust within 1 % or 1 mN (of a free "
    "robot: the forward speed within 1 % or 1 mm/s), and the tip's range within 1 %, unless the "
    "robot is free; null for a "
    "trial of less than two strides",
    "rmse_to_measured": "root mean square of simulated minus measured readings for all samples of "
    "the trial's file; null without a file",
}

STEADY, STEADY_THRUST, STEADY_SPEED = 0.01, 1e-3, 1e-3
"""Allowed differences of two strides: as a fraction of a quantity, as a mean thrust [N], and as a
forward speed [m/s]."""
AT_REST = 1e-4
"""A slower robot [m/s] has no course."""


def averaging_window(run: TrialRun) -> tuple[slice, int]:
    """Returns the averaging window without the first step, and the number of whole strides."""
    half, steps = run.grid.half_period, run.grid.steps
    if half is None:
        return slice(steps // 2 + 1, steps + 1), 0
    strides = steps // (2 * half)
    if strides == 0:
        return slice(1, steps + 1), 0
    kept = max(1, strides // 2)
    return slice(steps - kept * 2 * half + 1, steps + 1), kept


def is_free(run: TrialRun) -> bool:
    """Returns whether the robot swims freely, so that nothing measures the forces on its head."""
    return run.trial.support == "free"


def mean_velocity(run: TrialRun, first: int, last: int) -> tuple[float, float | None]:
    """Returns the forward speed [m/s] and the course [rad] of a free robot between two steps.

    A robot in three dimensions is seen from above.
    The course is None if the robot is slower than `AT_REST`.
    """
    head, ahead = run.series["head"], run.series["ahead"][first + 1 : last + 1].mean(axis=0)
    velocity = (head[last] - head[first])[:2] / (run.grid.h * (last - first))
    speed = float(np.hypot(*velocity))
    course = None if speed < AT_REST else float(np.arctan2(velocity[1], velocity[0]))
    return speed if velocity @ ahead[:2] >= 0.0 else -speed, course


def is_periodic(run: TrialRun) -> tuple[bool | None, str]:
    """Returns whether the last two strides agree (None: unknown), and a warning or ""."""
    half, steps = run.grid.half_period, run.grid.steps
    if half is None:
        return None, ""
    stride = 2 * half
    if steps < stride:
        period = stride * run.grid.h
        return None, f"the stride ({period:.3g} s) is longer than the trial; means cover the trial"
    if steps < 2 * stride:
        return None, "the trial is too short to compare two strides; the motion may not be periodic"
    ends = steps - stride, steps
    range_before, range_last = (np.ptp(run.series["tip"][i - stride : i + 1]) for i in ends)
    changes = []
    if is_free(run):
        before, last = (mean_velocity(run, i - stride, i)[0] for i in ends)
        name, unit, least = "forward speed", "mm/s", STEADY_SPEED
    else:
        before, last = (run.series["thrust"][i - stride + 1 : i + 1].mean() for i in ends)
        name, unit, least = "mean thrust", "mN", STEADY_THRUST
    if abs(last - before) > max(least, STEADY * abs(last)):
        changes.append(f"{name} from {1e3 * before:.2f} to {1e3 * last:.2f} {unit}")
    if not is_free(run) and abs(range_last - range_before) > STEADY * range_last:
        ranges = f"{1e3 * range_before:.2f} to {1e3 * range_last:.2f} mm"
        changes.append(f"range of the tip from {ranges}")
    if not changes:
        return True, ""
    return False, (
        f"not periodic: the last two strides differ: {' and '.join(changes)}; extend the trial "
        f"(duration = {2.0 * run.trial.duration:.3g})"
    )


def rmse_to_measured(run: TrialRun) -> dict[str, float] | None:
    """Returns the rms of simulated minus measured readings by column; None without measurement."""
    columns = run.prepared.measured
    if columns is None:
        return None
    names = run.prepared.channels.columns[1:]
    errors = {name: run.columns[name] - columns[name] for name in names if name in columns}
    return {
        name: float(np.sqrt(np.nanmean(error**2)))
        for name, error in errors.items()
        if np.isfinite(error).any()
    }


def trial_summary(experiment: Experiment, run: TrialRun) -> dict[str, Any]:
    """Returns the quantities of `DEFINITIONS`, coefficients, time step and warnings of a trial."""
    span, strides = averaging_window(run)
    loads: dict[str, float | None] = dict.fromkeys(
        ("mean_thrust_N", "thrust_std_N", "recoil_rms_N", "forward_speed_m_per_s", "course_rad")
    )
    if is_free(run):
        speed, course = mean_velocity(run, span.start - 1, span.stop - 1)
        loads |= {"forward_speed_m_per_s": speed, "course_rad": course}
    else:
        thrust, recoil = run.series["thrust"][span], run.series["recoil"][span]
        loads |= {"mean_thrust_N": thrust.mean(), "recoil_rms_N": np.sqrt(np.mean(recoil**2))}
        if strides > 1:
            loads["thrust_std_N"] = thrust.reshape(strides, -1).mean(axis=1).std(ddof=1)
    tip = run.series["tip"][span.start - 1 : span.stop]
    C_d, m_a = drag_and_added_mass(experiment, run.trial)
    periodic, warning = is_periodic(run)
    averaged = "second half" if run.grid.half_period is None else "whole trial"
    if strides:
        averaged = "last stride" if strides == 1 else f"last {strides} strides"
    return {
        "file": run.trial.file,
        "waveform": run.trial.waveform,
        "frequency_Hz": run.trial.frequency,
        "tow_speed_m_per_s": run.trial.tow_speed,
        "C_d": C_d,
        "m_a": m_a,
        "averaged": averaged,
        "averaged_from_s": run.t[span.start - 1],
        "averaged_to_s": run.t[span.stop - 1],
        **loads,
        "tip_half_range_m": None if is_free(run) else 0.5 * np.ptp(tip),
        "periodic": periodic,
        "warnings": [warning] if warning else [],
        "rmse_to_measured": rmse_to_measured(run),
        "step_s": run.grid.h,
        "steps": run.grid.steps,
        "factorisations": run.factorisations,
    }


def simulation_summary(
    experiment: Experiment, trials: list[dict[str, Any]], path: Path, model: Path | None
) -> dict[str, Any]:
    """Returns the content of summary.json; `trials` are results of `trial_summary`."""
    return {
        "name": experiment.name,
        "input": input_file(path),
        "model": None if model is None else input_file(model),
        "seed": None,
        **provenance(),
        "trials": trials,
        "definitions": DEFINITIONS,
        "settings": experiment.model_dump(),
    }
