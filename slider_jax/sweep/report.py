"""Writes the files of a sweep: table, settings, and a line or contour plot."""

import json
from pathlib import Path

import numpy as np

from slider_jax.io.figures import new_figure, save_figure
from slider_jax.io.files import input_file, provenance, staged, write_csv, write_json
from slider_jax.sweep.sweep import Axis, Sweep, digest

DRAWN = (
    ("thrust_mean_N", "mean thrust (mN)", 1e3),
    ("recoil_rms_N", "recoil, rms (mN)", 1e3),
    ("tip_half_range_m", "tip, half range (mm)", 1e3),
    ("chamber_power_W", "power of the chambers (mW)", 1e3),
)
"""Plotted column, its label with unit, and the factor from the SI unit to the unit in the label."""
DRAWN_OF_SWIMMERS = (
    ("speed_m_per_s", "speed (cm/s)", 1e2),
    ("cost_of_transport", "cost of transport", 1.0),
    ("tail_amplitude_m", "tail amplitude (mm)", 1e3),
    ("power_W", "power of the chambers (mW)", 1e3),
)


def plotted_columns(sweep: Sweep) -> tuple[tuple[str, str, float], ...]:
    """Returns the plotted columns with labels and factors, in the form of `DRAWN`."""
    return DRAWN_OF_SWIMMERS if sweep.swim else DRAWN


FILES = ("sweep.csv", "sweep.json", "sweep.png")


def is_written(sweep: Sweep, folder: Path) -> bool:
    """Returns whether `folder` holds the complete result of this sweep with the same versions."""
    if not all((folder / name).is_file() for name in FILES):
        return False
    try:
        record = json.loads((folder / "sweep.json").read_bytes())
    except ValueError:
        return False
    return isinstance(record, dict) and record.get("sha256") == digest(sweep.settings())


def write_sweep(sweep: Sweep, table: dict[str, np.ndarray], folder: Path, source: Path) -> None:
    """Writes sweep.csv, sweep.json and sweep.png. If an error occurs, no file changes."""
    settings = sweep.settings()
    record = {
        "settings": settings,
        "sha256": digest(settings),
        "input": input_file(source),
        "seed": None,
        "failed_rows": np.flatnonzero(np.isnan(table[plotted_columns(sweep)[0][0]])),
        **provenance(),
    }
    with staged(folder) as stage:
        write_csv(stage / "sweep.csv", table)
        write_json(stage / "sweep.json", record)
        plot_sweep(sweep, table, stage / "sweep.png")


_SHOWN = {"Pa": ("kPa", 1e-3), "m": ("mm", 1e3), "s": ("ms", 1e3)}
_POWERS = str.maketrans({"2": "²", "3": "³", "^": None})


def _axis(axis: Axis) -> tuple[np.ndarray, str]:
    """Returns the values of an axis in its displayed unit, and its label."""
    unit, factor = _SHOWN.get(axis.unit, (axis.unit.translate(_POWERS), 1.0))
    label = f"{axis.field} ({unit})" if unit else axis.field
    return factor * np.asarray(axis.values), label


def plot_sweep(sweep: Sweep, table: dict[str, np.ndarray], path: Path) -> None:
    """Plots lines (one varied field) or contours (two fields). Failed points are left blank."""
    figure, axes = new_figure(2, 2, figsize=(10, 7), sharex=True)
    x, along = _axis(sweep.axes[0])
    for ax, (name, label, factor) in zip(axes.flat, plotted_columns(sweep), strict=True):
        values = factor * table[name]
        if len(sweep.axes) == 1:
            ax.plot(x, values, "o-", ms=4)
            if np.nanmin(values, initial=0.0) < 0.0 < np.nanmax(values, initial=0.0):
                ax.axhline(0.0, color="k", lw=0.6)
            ax.set_ylabel(label)
        else:
            y, across = _axis(sweep.axes[1])
            plot_contours(figure, ax, x, y, values.reshape(len(x), len(y)).T, label)
            ax.set_ylabel(across)
        if ax in axes[-1]:
            ax.set_xlabel(along)
    head = f"{sweep.experiment.name}, {sweep.experiment.trials[sweep.trial].file}"
    averaged = f"last {sweep.strides - sweep.transient} of {sweep.strides} strides"
    shown = "free swimming, one steady stride" if sweep.swim else averaged
    figure.suptitle(f"{head}: {shown}", fontsize="medium")
    save_figure(figure, path)


def plot_contours(figure, ax, x: np.ndarray, y: np.ndarray, values: np.ndarray, label: str) -> None:
    """Plots labelled contour lines at round levels, and three colours between two lines."""
    from matplotlib.ticker import MaxNLocator

    low, high = np.nanmin(values, initial=np.inf), np.nanmax(values, initial=-np.inf)
    if not low < high:
        ax.text(0.5, 0.5, f"{label}: all values are equal", ha="center", transform=ax.transAxes)
        return
    round_levels = MaxNLocator(7, steps=[1, 2, 5, 10]).tick_values(low, high)
    fine = np.linspace(round_levels[0], round_levels[-1], 3 * (len(round_levels) - 1) + 1)
    grid = np.ma.masked_invalid(values)
    drawn = ax.contourf(x, y, grid, levels=fine, cmap="viridis")
    lines = ax.contour(x, y, grid, levels=round_levels, colors="k", linewidths=0.6)
    for text in ax.clabel(lines, fontsize=8, fmt="%g"):
        place = (ax.transData + ax.transAxes.inverted()).transform(text.get_position())
        inside = np.all((0.05 < place) & (place < 0.95))
        text.set_visible(bool(inside))  # hides labels that the frame would cut
    figure.colorbar(drawn, ax=ax, label=label, ticks=round_levels).add_lines(lines)
