"""Draws the pictures of the frequency sweep."""

from pathlib import Path

import numpy as np

from slider_jax import paper
from slider_jax.channels import SLIDER_CHANNELS
from slider_jax.io.figures import new_figure, save_figure
from slider_jax.reproduction.frequency_sweep import (
    FrequencySeries,
    FrequencySweep,
    FrequencySweepSettings,
)


def thrust_against_frequency(
    sweep: FrequencySweep, settings: FrequencySweepSettings, path: Path
) -> None:
    """Plots mean thrust, with standard deviations between strides, like the paper's Fig. 4."""
    table = sweep.table
    f, mean = table["frequency_Hz"], 1e3 * table["thrust_mean_N"]
    figure, ax = new_figure(figsize=(8, 4.8))
    ax.axvspan(paper.RAMP_START, paper.RAMP_END, color="0.92", label="ramp of C_d and m_a")
    ax.axhline(0.0, color="k", lw=0.6)
    bars = 1e3 * table["thrust_std_of_strides_N"]
    simulated = "simulated, mean and standard deviation of strides"
    ax.errorbar(f, mean, bars, fmt="o-", ms=4, lw=1.2, capsize=3, label=simulated)
    at, thrust = paper.PEAK_AT, 1e3 * paper.PEAK_THRUST
    ax.plot(at, thrust, "C3*", ms=14, label=f"paper: peak near {thrust:.0f} mN at {at:g} Hz")
    minimum = f"paper: minimum, negative, near {paper.MINIMUM_NEAR:g} Hz"
    ax.axvline(paper.MINIMUM_NEAR, color="C3", ls=":", lw=1.5, label=minimum)
    ax.set(xlabel="stride frequency (Hz)", ylabel="mean thrust (mN)")
    ax.set_xlim(0.0, float(f.max()) + 0.4)
    ax.legend(loc="lower right", fontsize="small")
    ax.set_title(_subtitle(settings), fontsize="medium")
    save_figure(figure, path)


def _subtitle(settings: FrequencySweepSettings) -> str:
    a = settings.assumed
    front = 1e-3 * float(a.amplitude)
    return (
        f"head fixed, still water; assumed: front +-{front:g} kPa, rear "
        f"+-{front * float(a.rear_ratio):g} kPa, {float(a.phase):g} of a stride later"
    )


def stride_in_detail(
    frequency: float, series: FrequencySeries, settings: FrequencySweepSettings, path: Path
) -> None:
    """Plots midlines of the last stride, and readings of three strides, as in Figs. 5 and 6."""
    figure, _ = new_figure(figsize=(10, 8.5))
    figure.clear()
    grid = figure.add_gridspec(3, 2, height_ratios=(1.3, 1.0, 1.0))
    _draw_midlines(figure, figure.add_subplot(grid[0, :]), series)
    steps = settings.steps_per_stride
    shown = slice(max(0, len(series.t) - 3 * steps - 1), None)
    t, first = series.t[shown], None
    for place, names in enumerate((("p_front", "p_rear"), ("tip",), ("thrust",), ("recoil",))):
        ax = first = figure.add_subplot(grid[1 + place // 2, place % 2], sharex=first)
        channel = SLIDER_CHANNELS[names[0]]
        drawn = np.transpose([channel.plot_factor * series.channels[name][shown] for name in names])
        lines = ax.plot(t, drawn, lw=1.3)
        ax.axhline(0.0, color="k", lw=0.4)
        label = channel.label if len(names) == 1 else "pressure"
        ax.set(xlabel="time (s)", ylabel=f"{label} ({channel.plot_unit})")
        ax.margins(x=0.0)
        if len(names) > 1:
            above = {"loc": "lower right", "bbox_to_anchor": (1.0, 0.98), "borderaxespad": 0.0}
            ax.legend(lines, ("front", "rear"), ncols=2, fontsize="small", frameon=False, **above)
    mean = 1e3 * series.channels["thrust"][-steps:].mean()
    thrust = figure.axes[-2]
    thrust.axhline(mean, color="C3", ls="--", lw=1.0)
    thrust.set_title(f"mean of the last stride {mean:.1f} mN", fontsize="small", loc="right")
    figure.suptitle(f"{frequency:g} Hz; {_subtitle(settings)}", fontsize="medium")
    save_figure(figure, path)


def _draw_midlines(figure, ax, series: FrequencySeries) -> None:
    import matplotlib

    colours = matplotlib.colormaps["viridis"]
    poses = len(series.midlines)
    for pose, midline in enumerate(1e3 * series.midlines):
        ax.plot(*midline, color=colours(0.95 * (pose + 1) / poses), lw=1.4)
    ax.plot(0.0, 0.0, "ks", ms=8)
    ax.annotate("clamp", (0.0, 0.0), (0, 10), textcoords="offset points", ha="center")
    length, swing = 1e3 * np.ptp(series.midlines[:, 0]), 1e3 * np.abs(series.midlines[:, 1]).max()
    ax.set_xlim(-1.03 * length, 0.05 * length)
    ax.set_ylim(*(side * max(1.2 * swing, 0.1 * length) for side in (-1, 1)))
    ax.set(aspect="equal", xlabel="x, forward from the clamp (mm)", ylabel="y, lateral (mm)")
    scale = matplotlib.cm.ScalarMappable(matplotlib.colors.Normalize(0.0, 1.0), colours)
    figure.colorbar(scale, ax=ax, label="phase of last stride (-)", fraction=0.04)
