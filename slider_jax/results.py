"""What is said of a simulated trial in few numbers, and the record of how it was made."""

from pathlib import Path
from typing import Any

import numpy as np

from slider_jax.experiment import Experiment
from slider_jax.provenance import input_file, versions
from slider_jax.simulate import Run

DEFINITIONS = {
    "mean_thrust_N": "mean over the averaged window; positive forward, along the clamp",
    "thrust_std_N": "standard deviation of the means of single strides in the window; null for one",
    "recoil_rms_N": "root mean square over the window of the lateral force on the clamp",
    "tip_half_range_m": "half of (largest - smallest) lateral position of the tail's tip",
    "averaged": "window of half as many whole strides as the trial has, at least one, that ends "
    "with the trial; the second half of a trial without a frequency",
}


def window(run: Run) -> tuple[slice, int]:
    """Steps of the averaged window (start left out, end kept), and its whole strides."""
    half = run.clock.half_period
    strides = run.clock.steps // (2 * half) if half else 0
    if half is None or strides == 0:
        return slice(run.clock.steps // 2 + 1, run.clock.steps + 1), 0
    kept = max(1, strides // 2)
    return slice(run.clock.steps - kept * 2 * half + 1, run.clock.steps + 1), kept


def trial_summary(run: Run) -> dict[str, Any]:
    """The numbers of `DEFINITIONS` for one trial, with its step."""
    span, strides = window(run)
    thrust, recoil = run.series["thrust"][span], run.series["recoil"][span]
    tip = run.series["tip"][span.start - 1 : span.stop]
    per_stride = thrust.reshape(strides, -1).mean(axis=1) if strides else np.array([])
    return {
        "file": run.trial.file,
        "waveform": run.trial.waveform,
        "frequency_Hz": run.trial.frequency,
        "tow_speed_m_per_s": run.trial.tow_speed,
        "averaged": f"last {strides} strides" if strides else "second half",
        "averaged_from_s": run.t[span.start - 1],
        "averaged_to_s": run.t[span.stop - 1],
        "mean_thrust_N": thrust.mean(),
        "thrust_std_N": per_stride.std(ddof=1) if strides > 1 else None,
        "recoil_rms_N": np.sqrt(np.mean(recoil**2)),
        "tip_half_range_m": 0.5 * np.ptp(tip),
        "step_s": run.clock.h,
        "steps": run.clock.steps,
        "newton_iterations": run.newton,
    }


def summary(
    experiment: Experiment, runs: list[Run], path: Path, model: Path | None
) -> dict[str, Any]:
    """The content of summary.json."""
    return {
        "name": experiment.name,
        "input": input_file(path),
        "model": None if model is None else input_file(model),
        "seed": None,
        "versions": versions(),
        "trials": [trial_summary(run) for run in runs],
        "definitions": DEFINITIONS,
        "settings": experiment.model_dump(),
    }
