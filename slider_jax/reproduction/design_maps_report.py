"""Draws the design maps and their slices, like the paper's Fig. 7."""

from pathlib import Path

import numpy as np

from slider_jax.io.figures import new_figure, save_figure
from slider_jax.reproduction.design_maps import (
    BEST_PHASE,
    MARKED,
    MARKED_LENGTH,
    Map,
    Peak,
    best_phase,
    best_stiffness,
)
from slider_jax.sweep.report import plot_contours

SHOWN_LENGTHS = (0.02, 0.04, 0.06, 0.08, 0.10)
"""Tail lengths of the slices [m]."""
STIFFNESS, PHASE = "stiffness EI of the tail (mN m²)", "phase of the rear chamber (of a period)"
LENGTH, SPEED = "length of the tail (mm)", "steady speed, head first (cm/s)"


def plot_design_maps(over_stiffness: Map, over_phase: Map, title: str, path: Path) -> None:
    """Writes the picture. Where speeds are NaN, maps are hatched and slices have gaps."""
    figure, ((a, b), (c, d)) = new_figure(2, 2, figsize=(11, 8.6))
    _draw_map(figure, a, over_stiffness, best_stiffness(over_stiffness), 1e3)
    a.set(yscale="log", ylabel=STIFFNESS)
    a.yaxis.set_major_formatter("{x:g}")
    _draw_map(figure, b, over_phase, best_phase(over_phase), 1.0)
    b.axhline(BEST_PHASE, color="w", ls=":", lw=1.2)
    b.set(ylabel=PHASE)
    _draw_slices(c, over_stiffness, best_stiffness(over_stiffness), 1e3)
    c.set(xscale="log", xlabel=STIFFNESS)
    c.xaxis.set_major_formatter("{x:g}")
    c.legend(title="tail", fontsize="small", loc="lower center")
    _draw_slices(d, over_phase, best_phase(over_phase), 1.0)
    _mark(d, over_phase)
    d.axhline(0.0, color="k", lw=0.5)
    d.set(xlabel=PHASE)
    names = ("stiffness", "phase", "slices of a", "slices of b")
    for letter, ax, name in zip("abcd", (a, b, c, d), names, strict=True):
        ax.set_title(f"{letter}: {name}", loc="left", fontsize="medium")
    lost = sum(int(np.isnan(x.speed).sum()) for x in (over_stiffness, over_phase))
    note = f"; hatched: no steady speed found, {lost} points" if lost else ""
    figure.suptitle(f"{title}\ncircles, triangles: best at each length{note}", fontsize="medium")
    save_figure(figure, path)


def _draw_map(figure, ax, drawn: Map, peaks: list[Peak], factor: float) -> None:
    """Draws a map and its maxima; `factor` converts the second variable to its displayed unit."""
    lengths, best = 1e3 * drawn.lengths, factor * np.array([p.x for p in peaks])
    ax.patch.set(hatch="////", facecolor="w", edgecolor="0.6")
    plot_contours(figure, ax, lengths, factor * drawn.across, 1e2 * drawn.speed.T, SPEED)
    ax.plot(lengths, best, "o", color="w", mec="k", mew=0.6, ms=5)
    ax.set(xlabel=LENGTH, ylim=factor * drawn.across[[0, -1]])


def _shown(drawn: Map) -> list[int]:
    return [int(np.argmin(np.abs(drawn.lengths - length))) for length in SHOWN_LENGTHS]


def _draw_slices(ax, drawn: Map, peaks: list[Peak], factor: float) -> None:
    import matplotlib

    colours = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.9, len(SHOWN_LENGTHS)))
    for i, colour in zip(_shown(drawn), colours, strict=True):
        label = f"{1e3 * drawn.lengths[i]:.3g} mm"
        ax.plot(factor * drawn.across, 1e2 * drawn.speed[i], color=colour, lw=1.6, label=label)
        ax.plot(factor * peaks[i].x, 1e2 * peaks[i].y, "^", color=colour, ms=7)
    ax.set(ylabel=SPEED)


def _mark(ax, over_phase: Map) -> None:
    """Marks three phases at 60 mm, and the paper's best phase."""
    one = over_phase.slice_at(MARKED_LENGTH)
    speeds = [1e2 * float(one.at(phase)[0]) for phase in MARKED]
    ax.plot(MARKED, speeds, "ko", ms=6, zorder=5, clip_on=False)
    label = {"textcoords": "offset points", "ha": "center", "fontweight": "bold"}
    for phase, speed, beside in zip(MARKED, speeds, ((0, -16), (20, 8), (0, -16)), strict=True):
        if np.isfinite(speed):
            ax.annotate(f"{phase:g}", (phase, speed), beside, **label)
    paper = ax.axvline(BEST_PHASE, color="0.4", ls=":", lw=1.2)
    paper.set_label(f"paper's best, {BEST_PHASE:g}")
    ax.legend(handles=[paper], fontsize="small", loc="lower center")
