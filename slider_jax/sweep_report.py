"""What a sweep of fields writes: the table, its record, and a line or contour plot."""

import json
from pathlib import Path

import numpy as np

from slider_jax.figures import new_figure, save_figure
from slider_jax.files import staged, write_csv, write_json
from slider_jax.provenance import input_file, versions
from slider_jax.sweep import Axis, Sweep, digest

DRAWN = (
    ("thrust_mean_N", "mean thrust (mN)", 1e3),
    ("recoil_rms_N", "recoil, rms (mN)", 1e3),
    ("tip_half_range_m", "tip, half range (mm)", 1e3),
    ("chamber_power_W", "power of the chambers (mW)", 1e3),
)
"""Column, label with unit, factor from SI."""


FILES = ("sweep.csv", "sweep.json", "sweep.png")


def is_written(sweep: Sweep, folder: Path) -> bool:
    """Whether `folder` holds the whole result of this very sweep, versions included."""
    if not all((folder / name).is_file() for name in FILES):
        return False
    try:
        record = json.loads((folder / "sweep.json").read_bytes())
    except ValueError:
        return False
    return isinstance(record, dict) and record.get("sha256") == digest(sweep.settings())


def write_results(sweep: Sweep, table: dict[str, np.ndarray], folder: Path, source: Path) -> None:
    """Write sweep.csv, sweep.json and sweep.png, all or none of them."""
    settings = sweep.settings()
    failed = np.flatnonzero(np.isnan(table["thrust_mean_N"]))
    record = {
        "settings": settings,
        "sha256": digest(settings),
        "input": input_file(source),
        "seed": None,
        "failed_rows": failed,
        "versions": versions(),
    }
    with staged(folder) as stage:
        write_csv(stage / "sweep.csv", table)
        write_json(stage / "sweep.json", record)
        draw(sweep, table, stage / "sweep.png")


def _label(axis: Axis) -> str:
    return f"{axis.field} ({axis.unit})" if axis.unit else axis.field


def draw(sweep: Sweep, table: dict[str, np.ndarray], path: Path) -> None:
    """Lines over one field, or filled contours over two; a member that failed is left out."""
    figure, axes = new_figure(2, 2, figsize=(10, 7), sharex=True)
    x = sweep.axes[0]
    for ax, (name, label, factor) in zip(axes.flat, DRAWN, strict=True):
        values = factor * table[name]
        if len(sweep.axes) == 1:
            ax.plot(x.values, values, "o-", ms=4)
            if name == "thrust_mean_N":
                ax.axhline(0.0, color="k", lw=0.6)
            ax.set_ylabel(label)
        else:
            y = sweep.axes[1]
            grid = np.ma.masked_invalid(values.reshape(len(x.values), len(y.values)).T)
            drawn = ax.contourf(x.values, y.values, grid, levels=15, cmap="viridis")
            lines = ax.contour(drawn, levels=drawn.levels[::3], colors="k", linewidths=0.5)
            ax.clabel(lines, fontsize=7)
            figure.colorbar(drawn, ax=ax, label=label)
            ax.set_ylabel(_label(y))
        if ax in axes[-1]:
            ax.set_xlabel(_label(x))
    trial = sweep.experiment.trials[sweep.trial]
    averaged = sweep.strides - sweep.transient
    figure.suptitle(
        f"{sweep.experiment.name}, {trial.file}: last {averaged} of {sweep.strides} strides",
        fontsize="medium",
    )
    save_figure(figure, path)
