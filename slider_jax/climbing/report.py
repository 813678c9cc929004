"""Writes the table, the summary, the picture and the film of a climb."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from slider_jax.climbing.climb import ClimbRun
from slider_jax.io.figures import new_figure, save_figure, save_film
from slider_jax.swimming.report import value_lines

ROWS = (
    ("speed_m_per_s", "climbing speed U", "mm/s", 1e3),
    ("drift_m_per_s", "drift to the left", "mm/s", 1e3),
    ("power_W", "power P", "mW", 1e3),
    ("efficiency", "efficiency m g U/P", "", 1.0),
    ("dissipated_of_power", "dissipated power", "% of P", 1e2),
    ("stored_of_power", "growth of stored energy", "% of P", 1e2),
    ("unaccounted_of_power", "error of the time steps", "% of P", 1e2),
    ("swing_rad", "swing of the head, peak to peak", "deg", 180.0 / np.pi),
    ("tail_swing_m", "swing of the tip, peak to peak", "mm", 1e3),
)
"""Rows of the table: name in `climb_record`, label, displayed unit, factor from the SI unit."""
FILM_STRIDES, FRAMES_PER_STRIDE = 4, 24


def climb_table(row: dict[str, Any]) -> str:
    """Returns the table of the quantities in `row` (a `climb_record`) as text."""
    return "\n".join(value_lines(row, ROWS))


def climb_summary(run: ClimbRun) -> list[str]:
    """Returns sentences about the pressure cap, the pin phase and the period of the strides."""
    lines = []
    if not run.is_driven:
        return ["the set pressures are 0: the left end stays pinned and the robot hangs"]
    cut = [f"{k} {1e-3 * abs(p):g} kPa" for k, p in run.set_pressures.items() if abs(p) > run.cap]
    if cut:
        lines.append(f"set pressures are cut to {1e-3 * run.cap:g} kPa; given: {', '.join(cut)}")
    left, right = run.pin_phase % 1.0, (run.pin_phase + 0.5) % 1.0
    phase = f"the left end is pinned at {left:g} of a period, the right end at {right:g}"
    lines.append(phase + (f"; fastest of {len(run.tried)} pin phases" if run.tried else ""))
    if float(run.found.power) <= 0.0:
        lines.append("the chambers absorb more power than they supply: efficiency is undefined")
    last = 1e3 * np.asarray(run.found.rises)
    each = f"{last.mean():.2f} mm per stride"
    if run.period == 1:
        lines.append(f"strides repeat: the robot rises by {each}")
    elif run.period:
        lines.append(f"the motion repeats after {run.period} strides; the mean rise is {each}")
    else:
        spread = f"{last.min():.1f} to {last.max():.1f}"
        lines.append(
            f"strides do not repeat within {len(run.rises) + run.plan.strides} strides; the rise "
            f"of the last {run.plan.strides} strides is {spread} mm, on average {each}"
        )
    return lines


def series_columns(run: ClimbRun) -> dict[str, np.ndarray]:
    """Returns CSV columns of the last strides.

    x points up. The origin is the centre of mass at the first time step of these strides.
    """
    x, steps = run.series, run.plan.steps_per_stride
    start = x.centre[0]
    places = {"head": x.midline[:, :, -1], "tip": x.midline[:, :, 0], "pin": x.pin,
              "centre": x.centre}  # fmt: skip
    return {
        "t_s": np.arange(len(x.angle)) / (steps * run.frequency),
        **{f"{k}_{axis}_m": p[:, i] - start[i] for k, p in places.items() for i, axis in
           enumerate("xy")},
        "head_angle_rad": x.angle,
        "power_W": x.power,
        "dissipated_W": x.dissipated,
        "stored_J": x.stored,
    }  # fmt: skip


def _sideways(points: np.ndarray, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns points (..., 2, n) [m] as (right, up) [mm] from `origin`; x is up, y is left."""
    return -1e3 * (points[..., 1, :] - origin[1]), 1e3 * (points[..., 0, :] - origin[0])


def plot_climb(run: ClimbRun, path: Path) -> None:
    """Plots one stride on the wall, and the rise against time."""
    figure, (wall, right) = new_figure(1, 2, figsize=(9.5, 6), width_ratios=(2, 3))
    x, steps = run.series, run.plan.steps_per_stride
    origin = x.midline[-steps - 1, :, -1]
    for i in range(0, steps + 1, max(1, steps // 12)):
        shade = f"{0.8 * (1.0 - i / steps):.3f}"
        wall.plot(*_sideways(x.midline[i - steps - 1], origin), color=shade, lw=1.2)
    wall.plot(*_sideways(x.midline[-steps - 1 :, :, -1].T, origin), "C3", lw=1.5, label="head")
    wall.plot(*_sideways(x.midline[-steps - 1 :, :, 0].T, origin), "C0", lw=1.0, label="tip")
    pins = np.unique(np.round(x.pin[-steps:], 5), axis=0)
    wall.plot(*_sideways(pins.T, origin), "ks", ms=5, label="pins")
    wall.set(aspect="equal", xlabel="across (mm)", ylabel="up (mm)")
    below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.1), "frameon": False}
    wall.legend(fontsize="small", ncols=3, handlelength=1.0, columnspacing=1.0, **below)
    wall.set_title("one stride, later midlines are darker", fontsize="medium")
    t = np.arange(len(x.angle)) / (steps * run.frequency)
    right.plot(t, 1e3 * (x.midline[:, 0, -1] - x.midline[0, 0, -1]), "C3", lw=1.2, label="head")
    right.plot(t, 1e3 * (x.centre[:, 0] - x.centre[0, 0]), "C0", lw=1.2, label="centre of mass")
    right.plot(t, 1e3 * float(run.found.speed) * t, "k--", lw=0.8,
               label=f"{1e3 * float(run.found.speed):.1f} mm/s")  # fmt: skip
    right.set(xlabel="time (s)", ylabel="risen (mm)")
    right.legend(fontsize="small", loc="upper left")
    right.margins(x=0.0)
    right.set_title(f"the last {len(run.found.rises)} strides", fontsize="medium")
    save_figure(figure, path)


def film(
    run: ClimbRun, path: Path, progress: Callable[[int, int], None] = lambda done, total: None
) -> None:
    """Writes a GIF of the last `FILM_STRIDES` strides, with horizontal lines every 10 mm."""
    x, steps = run.series, run.plan.steps_per_stride
    shown = np.linspace(
        max(0, len(x.angle) - 1 - FILM_STRIDES * steps), len(x.angle) - 1,
        FILM_STRIDES * FRAMES_PER_STRIDE + 1,
    ).round().astype(int)[:-1]  # fmt: skip
    origin = x.midline[shown[0], :, -1]
    across, up = _sideways(x.midline[shown], origin)
    figure, ax = new_figure(figsize=(4.5, 6.5), dpi=80)
    (body,) = ax.plot([], [], "C0", lw=5, solid_capstyle="round")
    (rod,) = ax.plot([], [], "0.3", lw=3)
    (pin,) = ax.plot([], [], "C3o", ms=8)
    (path_of_head,) = ax.plot([], [], "C3", lw=0.8)
    clock = ax.text(0.98, 0.02, "", transform=ax.transAxes, ha="right")
    reach = 1e3 * run.link
    low, high = up.min() - 10.0, up.max() + reach
    ax.set(xlim=(across.min() - reach, across.max() + reach), ylim=(low, high))
    for rung in np.arange(10.0 * np.ceil(low / 10.0), high, 10.0):
        ax.axhline(rung, color="0.9", lw=0.6, zorder=0)
    ax.set(aspect="equal", xlabel="across (mm)", ylabel="up (mm)")
    title = f"{run.frequency:g} Hz, {1e3 * float(run.found.speed):.1f} mm/s"
    ax.set_title(title, fontsize="medium")
    heads = x.midline[shown, :, -1]

    def move(number: int) -> None:
        i = shown[number]
        # The ends of the cross-link are to the left and to the right of the head.
        n = np.array([-np.sin(x.angle[i]), np.cos(x.angle[i])])
        head = heads[number]
        ends = np.stack([head + 0.5 * run.link * n, head - 0.5 * run.link * n], axis=1)
        body.set_data(*_sideways(x.midline[i], origin))
        rod.set_data(*_sideways(ends, origin))
        pin.set_data(*_sideways(x.pin[i][:, None], origin))
        path_of_head.set_data(*_sideways(heads[: number + 1].T, origin))
        clock.set_text(f"{(i - shown[0]) / (steps * run.frequency):.2f} s")

    moving = (body, rod, pin, path_of_head, clock)
    save_film(figure, moving, move, range(len(shown)), path, progress)
