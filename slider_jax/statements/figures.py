"""Draws the figures of the table of statements, in the form of the paper's Figs. 4 to 8."""

from pathlib import Path

import numpy as np

from slider_jax import paper
from slider_jax.io.figures import new_figure, save_figure
from slider_jax.statements.investigation import RobotStudy
from slider_jax.statements.quantities import STIFF
from slider_jax.statements.series import StrideSeries
from slider_jax.swimming.paper_optimum import PAPER_GAIT


def plot_thrust_sweep(f: np.ndarray, thrusts: dict[str, np.ndarray], path: Path) -> None:
    """Plots the thrusts (frequencies, strides) [N] at `f` [Hz] with the paper's facts (Fig. 4).

    The points are means over the strides, and the bars are standard deviations.
    """
    figure, ax = new_figure(figsize=(8, 4.8))
    ax.axhline(0.0, color="k", lw=0.6)
    for name, thrust in thrusts.items():
        mean, bars = 1e3 * thrust.mean(axis=1), 1e3 * thrust.std(axis=1, ddof=1)
        ax.errorbar(f, mean, bars, fmt="o-", ms=4, lw=1.2, capsize=2, label=name)
    at, peak = paper.PEAK_AT, 1e3 * paper.PEAK_THRUST
    ax.plot(at, peak, "k*", ms=14, label=f"paper: peak near {peak:g} mN at {at:g} Hz")
    end = np.array([at, 7.0])
    ax.plot(
        end, peak - 1e3 * paper.ROLL_OFF * (end - at), "k--", lw=1.2, label="paper: about -20 mN/Hz"
    )
    label = f"paper: minimum near {paper.MINIMUM_NEAR:g} Hz"
    ax.axvline(paper.MINIMUM_NEAR, color="k", ls=":", lw=1.5, label=label)
    ax.set(xlabel="tailbeat frequency (Hz)", ylabel="mean thrust (mN)", xlim=(0.0, 7.4))
    ax.legend(fontsize="small")
    save_figure(figure, path)


def plot_strides(strides: dict[str, StrideSeries], frequency: float, path: Path) -> None:
    """Plots pressure, tip, thrust, recoil and shapes of each robot, as in Figs. 5 and 6."""
    figure, axes = new_figure(4, len(strides), figsize=(5.5 * len(strides), 11), squeeze=False)
    limit = 1e3 * paper.RECOIL_THERE
    for column, (name, x) in enumerate(strides.items()):
        share = 100.0 * x.t * frequency
        top, thrust, recoil, shapes = axes[:, column]
        top.plot(share, 1e-3 * x.pressure, lw=1.2)
        top.set(ylabel="pressure (kPa)", title=name)
        twin = top.twinx()
        twin.plot(share, 1e3 * x.tip, "k", lw=1.2)
        twin.set_ylabel("tip (mm), black")
        thrust.plot(share, 1e3 * x.thrust, lw=1.2)
        mean = 1e3 * x.thrust.mean()
        thrust.axhline(mean, color="C3", ls="--", lw=1.0, label=f"mean {mean:.0f} mN")
        thrust.set_ylabel("thrust (mN)")
        thrust.legend(fontsize="small")
        recoil.plot(share, 1e3 * x.recoil, lw=1.2)
        above = 100.0 * np.mean(np.abs(1e3 * x.recoil) > limit)
        for side in (-limit, limit):
            recoil.axhline(side, color="0.5", ls=":", lw=1.0)
        recoil.set(ylabel="recoil (mN)", xlabel="percent of the stride")
        recoil.set_title(f"beyond {limit:.0f} mN for {above:.0f} % of the stride", fontsize="small")
        _draw_shapes(shapes, x)
    figure.suptitle(f"head fixed, {frequency:g} Hz", fontsize="medium")
    save_figure(figure, path)


def _draw_shapes(ax, x: StrideSeries) -> None:
    import matplotlib

    colours = matplotlib.colormaps["viridis"]
    steps = len(x.t)
    for percent in range(0, 100, 10):
        place = (percent * steps) // 100 - 1
        line = 1e3 * (x.midline[place] - x.midline[place][:, -1:])
        ax.plot(*line, color=colours(percent / 100.0), lw=1.3)
        ax.annotate(f"{percent}", line[:, 0], fontsize="x-small", ha="right")
    ax.set(aspect="equal", xlabel="x from the head (mm)", ylabel="y (mm)")


def plot_length_slice(studies: dict[str, RobotStudy], path: Path) -> None:
    """Plots the speed against the tail's length at 17 mN m^2, as in Fig. 7c."""
    figure, ax = new_figure(figsize=(7, 4.5))
    for name, x in studies.items():
        speeds = 100.0 * x.over_stiffness.at(STIFF)
        ax.plot(1e3 * x.over_stiffness.lengths, speeds, "o-", ms=4, label=name)
    ax.axvline(1e3 * PAPER_GAIT.tail_length, color="k", ls=":", label="paper's optimum, 53 mm")
    ax.axvline(70.0, color="k", ls="--", lw=1.0, label="paper's experiment, 70 mm")
    ax.set(xlabel="length of the tail (mm)", ylabel="steady speed (cm/s)")
    ax.set_title(f"EI of the tail {1e3 * STIFF:g} mN m², 5 Hz", fontsize="medium")
    ax.legend(fontsize="small")
    save_figure(figure, path)


POSES, BETWEEN = 10, 110.0
"""Number of shapes of a swimmer in a stride, and their distance [mm] in the figure."""


def plot_swimmer(strides: dict[str, StrideSeries], path: Path) -> None:
    """Draws shapes, forces of the water and active moments of the optimum, as in Fig. 8."""
    from matplotlib.collections import LineCollection

    figure, axes = new_figure(1, len(strides), figsize=(5.0 * len(strides), 10.5), squeeze=False)
    for ax, (name, x) in zip(axes[0], strides.items(), strict=True):
        steps = len(x.t)
        longest, largest = np.abs(x.force).max(), np.abs(x.moment).max()
        for pose in range(POSES):
            place = (pose * steps) // POSES - 1
            line = 1e3 * (x.midline[place] - x.midline[place].mean(axis=1, keepdims=True))
            line[1] -= BETWEEN * pose
            middle = 0.5 * (line[:, 1:] + line[:, :-1])
            segments = np.stack([line[:, :-1].T, line[:, 1:].T], axis=1)
            drawn = LineCollection(list(segments), cmap="coolwarm", lw=3.0)
            drawn.set_array(1e3 * x.moment[place])
            drawn.set_clim(-1e3 * largest, 1e3 * largest)
            ax.add_collection(drawn)
            arrows = 60.0 * x.force[place] / longest
            ax.quiver(*middle, *arrows, angles="xy", scale_units="xy", scale=1.0, width=0.003)
            ax.annotate(f"{pose / POSES:.1f}", (-215, -BETWEEN * pose), fontsize="small")
        ax.set(aspect="equal", xlim=(-225, 205), ylim=(-BETWEEN * POSES + 30, 80), yticks=[])
        ax.set(xlabel="x, head on the right (mm)")
        ax.set_title(f"{name}\nlongest arrow {longest:.0f} N/m", fontsize="medium")
        figure.colorbar(drawn, ax=ax, label="active moment (mN m)", fraction=0.04)
    figure.suptitle("paper's optimum, fraction of the stride on the left", fontsize="medium")
    save_figure(figure, path)
