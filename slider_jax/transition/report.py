"""Writes the summary, the series, the picture and the film of a way from the water to the wall."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from slider_jax.io.figures import new_figure, save_figure, save_film
from slider_jax.supports.gripping import HOLDING
from slider_jax.transition.run import CrossingRun, energies, outcome

FRAMES, PER_SECOND = 300, 12.0
"""Largest number of frames of the film, and frames per simulated second of a short film."""
SHOWN = 16
"""Number of bodies in the picture."""


def transition_summary(run: CrossingRun) -> list[str]:
    """Returns the lines that the command prints."""

    def at(name: str, time: float | None) -> str:
        return f"{name:24}{'-' if time is None else f'{time:8.2f} s'}"

    energy = energies(run)
    work = energy["work_J"]
    lines = [outcome(run)[1]]
    lines += [at("first grip", run.gripped), at("out of the water", run.left_water)]
    lines += [at("at the goal", run.reached)]
    names = {
        "work_J": "work of the chambers",
        "to_weight_and_buoyancy_J": "weight and buoyancy",
        "to_water_J": "water",
        "to_body_J": "viscosity of the body",
        "to_spines_J": "spines",
        "stored_J": "motion and bending",
        "unaccounted_J": "error of the time steps",
    }
    for key, label in names.items():
        lines.append(f"{label:24}{1e3 * energy[key]:8.1f} mJ{100.0 * energy[key] / work:8.1f} %")
    return lines


def crossing_columns(run: CrossingRun) -> dict[str, np.ndarray]:
    """Returns the CSV columns of all time steps; up from the surface, left from the start."""
    x = run.series
    places = {"head": x.head, "centre": x.centre, "tip": x.midline[:, :, 0]}
    return {
        "t_s": run.times,
        **{f"{k}_{axis}_m": v[:, i] for k, v in places.items() for i, axis in
           enumerate(("up", "left"))},
        "head_angle_rad": x.angle,
        "wet_fraction": x.wet,
        **{f"{side}_{k}": v[:, i] for i, side in enumerate(("left", "right")) for k, v in
           (("grip", x.status), ("load_N", x.load))},
        "power_W": x.power,
        "to_weight_and_buoyancy_W": x.to_weight,
        "to_water_W": x.to_water,
        "to_body_W": x.to_body,
        "to_spines_W": x.to_spines,
        "stored_J": x.stored,
    }  # fmt: skip


def _scene(axes, run: CrossingRun, low: float, high: float, half: float) -> None:
    """Draws the water and the wall from `low` to `high` and from -`half` to `half` [mm]."""
    bottom = 1e3 * run.table.wall_from
    axes.fill_between([-half, half], low, 0.0, color="#d8ecf8", lw=0, zorder=0)
    axes.fill_between(
        [-half, half], bottom, high, facecolor="none", edgecolor="0.8", hatch="..", lw=0, zorder=0
    )
    axes.axhline(0.0, color="C0", lw=1.0)
    axes.axhline(bottom, color="0.6", lw=0.8, ls="--")
    axes.axhline(1e3 * run.table.height, color="C2", lw=0.8, ls="--")
    axes.set(xlim=(-half, half), ylim=(low, high), aspect="equal", xlabel="across (mm)")


def _right_up(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns points (..., 2, n) [m] as (right, up) [mm]; the input is (up, left)."""
    return -1e3 * points[..., 1, :], 1e3 * points[..., 0, :]


def _limits(run: CrossingRun) -> tuple[float, float, float]:
    across, up = _right_up(run.series.midline)
    half = max(120.0, float(np.abs(across).max()) + 30.0)
    return float(up.min()) - 30.0, max(float(up.max()), 1e3 * run.table.height) + 40.0, half


def plot_transition(run: CrossingRun, path: Path) -> None:
    """Plots bodies at equal times, and height, wet fraction and powers against time."""
    figure, axes = new_figure(3, 2, figsize=(10, 8), width_ratios=(2, 3))
    grid = axes[0, 0].get_gridspec()
    for axis in axes[:, 0]:
        axis.remove()
    wall = figure.add_subplot(grid[:, 0])
    x, t = run.series, run.times
    low, high, half = _limits(run)
    _scene(wall, run, low, high, half)
    for k, i in enumerate(np.linspace(0, len(t) - 1, SHOWN).round().astype(int)):
        shade = f"{0.7 * (1.0 - k / SHOWN):.3f}"
        wall.plot(*_right_up(x.midline[i]), color=shade, lw=1.6)
    wall.plot(*_right_up(x.head.T), "C3", lw=0.6)
    wall.set(ylabel="height above the water (mm)")
    wall.set_title("bodies at equal times, later ones darker", fontsize="medium")
    height, wet, power = axes[:, 1]
    height.plot(t, x.head[:, 0], "C3", lw=1.2, label="head")
    height.plot(t, x.midline[:, 0, 0], "C0", lw=0.8, label="tip")
    for level, style in ((0.0, "C0-"), (run.table.height, "C2--")):
        height.axhline(level, color=style[:2], ls=style[2:], lw=0.8)
    height.set(ylabel="height (m)")
    height.legend(fontsize="small", loc="lower right")
    wet.plot(t, x.wet, "C0", lw=1.0, label="wet fraction")
    load = wet.twinx()
    load.plot(t, x.load.max(axis=1), "0.6", lw=0.3)
    load.set(ylabel="load of the grip (N)")
    wet.set(ylabel="wet fraction")
    work = {"chambers": x.power, "weight and buoyancy": x.to_weight, "water": x.to_water,
            "body": x.to_body, "spines": x.to_spines}  # fmt: skip
    for name, p in work.items():
        power.plot(t, run.settings.step * np.cumsum(p), lw=1.2, label=name)
    power.set(xlabel="time (s)", ylabel="energy (J)")
    below = {"loc": "upper center", "bbox_to_anchor": (0.45, -0.2), "frameon": False}
    power.legend(fontsize="small", ncols=5, handlelength=1.0, columnspacing=1.0, **below)
    for axis in (height, wet, power):
        axis.margins(x=0.0)
    save_figure(figure, path)


def film_transition(
    run: CrossingRun, path: Path, progress: Callable[[int, int], None] = lambda done, total: None
) -> None:
    """Writes a GIF of the whole way, with at most `FRAMES` frames."""
    x, t = run.series, run.times
    count = int(min(FRAMES, max(2, PER_SECOND * t[-1])))
    shown = np.linspace(0, len(t) - 1, count).round().astype(int)
    low, high, half = _limits(run)
    figure, axes = new_figure(figsize=(3.6, 8.0), dpi=80)
    _scene(axes, run, low, high, half)
    axes.set(ylabel="height above the water (mm)")
    (body,) = axes.plot([], [], "C0", lw=4, solid_capstyle="round")
    (rod,) = axes.plot([], [], "0.3", lw=3)
    (grips,) = axes.plot([], [], "C3o", ms=6)
    clock = axes.text(0.97, 0.02, "", transform=axes.transAxes, ha="right")

    def move(number: int) -> None:
        i = shown[number]
        n = np.array([-np.sin(x.angle[i]), np.cos(x.angle[i])])
        arms = 0.5 * run.table.link * np.array([1.0, -1.0])
        ends = x.head[i][:, None] + arms * n[:, None]
        body.set_data(*_right_up(x.midline[i]))
        rod.set_data(*_right_up(ends))
        grips.set_data(*_right_up(ends[:, x.status[i] == HOLDING]))
        clock.set_text(f"{t[i]:.1f} s")

    save_film(figure, (body, rod, grips, clock), move, range(count), path, progress)
