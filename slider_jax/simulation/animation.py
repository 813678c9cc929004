"""Draws a film of the last strides like the paper's Fig. 8: midline, forces and moment."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from slider_jax.io.figures import new_figure, save_film
from slider_jax.simulation.plots import last_strides, run_title
from slider_jax.simulation.trial import TrialRun

SHOWN_STRIDES, FRAMES_PER_STRIDE = 2, 40
ARROW = 50.0
"""Length of the longest force arrow [mm], on the scale of the axes."""


def animate_run(
    run: TrialRun, folder: Path, progress: Callable[[int, int], None] = lambda done, total: None
) -> Path:
    """Writes `<stem>.gif` and returns the path; calls `progress(frames done, total)` per frame.

    The film shows the last two strides (or two seconds) in slow motion. The midline's colour shows
    the net internal moment. Arrows show the water's force per length. Curves are thrust and recoil.
    """
    steps = last_strides(run, SHOWN_STRIDES * FRAMES_PER_STRIDE + 1, SHOWN_STRIDES, closed=True)
    figure, moving, move = _scene(run, steps)
    path = folder / f"{Path(run.trial.file).stem}.gif"
    save_film(figure, moving, move, steps.tolist(), path, progress)
    return path


def _scene(run: TrialRun, steps: np.ndarray):
    """Returns the figure, its moving artists, and a function that draws them at a time step."""
    from matplotlib.collections import LineCollection

    # The film of a robot in three dimensions shows the robot from above.
    line, moment = 1e3 * run.series["midline"][:, :2], 1e3 * run.series["moment"]
    shown, force = line[steps], run.series["force"][:, :2]
    largest = np.abs(moment[steps]).max() or 1.0
    strongest = np.linalg.norm(force[steps], axis=1).max() or 1.0

    figure, (ax, below) = new_figure(2, 1, figsize=(8, 6), dpi=90, height_ratios=(2, 1))
    body = LineCollection([], cmap="coolwarm", lw=5, capstyle="round")
    body.set_clim(-largest, largest)
    ax.add_collection(body)
    where = _cell_centres(line[steps[0]])[:, ::2]
    arrows = ax.quiver(
        *where, *np.zeros_like(where), angles="xy", scale=strongest / ARROW, scale_units="xy",
        width=0.003, color="0.25",
    )  # fmt: skip
    ax.quiverkey(arrows, 0.12, 0.93, 0.5 * strongest, f"{0.5 * strongest:.2g} N/m", labelpos="E")
    ax.plot(0.0, 0.0, "ks", ms=8)
    reach = np.abs(shown[:, 1]).max() + ARROW
    ax.set(xlim=(shown[:, 0].min() - 25.0, shown[:, 0].max() + 25.0), ylim=(-reach, reach))
    ax.set(aspect="equal", xlabel="x, forward from the clamp (mm)", ylabel="y, lateral (mm)")
    bar = {"location": "top", "shrink": 0.6, "aspect": 40}
    figure.colorbar(body, ax=ax, label="internal moment (mN m)", **bar)
    clock = ax.text(0.98, 0.05, "", transform=ax.transAxes, ha="right")
    figure.suptitle(run_title(run), fontsize="medium")

    span = slice(steps[0], steps[-1] + 1)
    for axis, name, colour in ((below, "thrust", "C0"), (below.twinx(), "recoil", "C1")):
        channel = run.prepared.channels[name]
        axis.plot(run.t[span], channel.plot_factor * run.series[name][span], colour, lw=1.2)
        axis.set_ylabel(f"{channel.label} ({channel.plot_unit})", color=colour)
        axis.margins(x=0.0)
    below.set_xlabel("time (s)")
    cursor = below.axvline(run.t[steps[0]], color="k", lw=1.0)

    def move(index: int) -> None:
        points = line[index].T
        body.set_segments(list(np.stack([points[:-1], points[1:]], axis=1)))
        body.set_array(0.5 * (moment[index][1:] + moment[index][:-1]))
        arrows.set_offsets(_cell_centres(line[index])[:, ::2].T)
        arrows.set_UVC(*force[index][:, ::2])
        clock.set_text(f"t = {run.t[index]:.3f} s")
        cursor.set_xdata([run.t[index]] * 2)

    return figure, (body, arrows, clock, cursor), move


def _cell_centres(line: np.ndarray) -> np.ndarray:
    return 0.5 * (line[:, 1:] + line[:, :-1])
