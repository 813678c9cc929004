"""A free swim in a table, and in a picture."""

from pathlib import Path
from typing import Any

import numpy as np

from slider_jax.io.figures import new_figure, save_figure
from slider_jax.swimming.free_swim import AT_ONCE, Swim
from slider_jax.swimming.paper_optimum import Published

ROWS = (
    ("speed_m_per_s", "speed U", "cm/s", 1e2),
    ("wavelength_m", "wavelength lambda", "mm", 1e3),
    ("wave_speed_m_per_s", "wave speed V", "cm/s", 1e2),
    ("travelling_index", "travelling index", "", 1.0),
    ("froude_efficiency", "Froude efficiency T U/P", "", 1.0),
    ("slender_efficiency", "slender body's, (1 + U/V)/2", "", 1.0),
    ("force_efficiency_N_per_W", "force efficiency T/P", "N/W", 1.0),
    ("tail_amplitude_m", "tail amplitude A_t", "mm", 1e3),
    ("strouhal", "Strouhal number 2 A_t f/U", "", 1.0),
    ("tail_slope", "tail slope A_t/(lambda/4)", "", 1.0),
    ("shape_wavelength_m", "wavelength of the shape", "mm", 1e3),
    ("shape_tail_slope", "tail slope with that", "", 1.0),
    ("power_W", "power P", "W", 1.0),
    ("cost_of_transport", "cost of transport P/(m g U)", "", 1.0),
    ("head_amplitude_m", "head amplitude", "mm", 1e3),
    ("turning_rad_per_stride", "turning, per stride", "mrad", 1e3),
)
"""Name in `swim.row`, words, unit shown, factor from SI to it."""


def swim_table(row: dict[str, Any], published: dict[str, Published]) -> str:
    """The rows, beside the paper's where it has them."""
    head = f"{'':34}{'here':>10}"
    if published:
        head += f"{'paper model':>14}{'ratio':>8}{'measured':>12}{'ratio':>8}"
    lines = [head]
    for name, words, unit, factor in ROWS:
        value = factor * row[name]
        line = f"{words + (f' ({unit})' if unit else ''):34}{value:10.4g}"
        for said, width in zip(published.get(name, ()), (14, 12), strict=False):
            shown = f"{factor * said:{width}.4g}{row[name] / said:8.2f}" if said else ""
            line += shown or " " * (width + 8)
        lines.append(line.rstrip())
    return "\n".join(lines)


def swim_summary(swim: Swim) -> list[str]:
    """How the speed was reached, and what it would be without the effects that resist."""
    end = swim.from_rest[-1]
    count = AT_ONCE * len(swim.from_rest)
    root, rest = f"{1e2 * float(swim.performance.speed):.2f} cm/s", f"{1e2 * end:.2f} cm/s"
    gaining = f"{1e2 * swim.gaining:+.2g} cm/s^2"
    if swim.found and swim.repeats:
        off = f"{1e2 * swim.difference:+.2f} %"
        said = [f"steady at {root}; from rest it repeats at {rest} after {count} strides ({off})"]
    elif swim.found:
        said = [f"steady at {root} as a root; from rest {rest} after {count} strides, {gaining}"]
    elif swim.repeats:
        said = [f"the root was not found; from rest it repeats at {rest} after {count} strides"]
    else:
        said = [
            f"no steady speed: from rest {rest} after {count} strides, and {gaining}; "
            + (
                f"{swim.resisting} resists too little, or the swim is not periodic"
                if swim.resisting
                else "nothing resists along the body: add an effect such as head_drag"
            )
        ]
    if swim.unresisted is not None:
        said.append(
            f"without {swim.resisting}: {1e2 * swim.unresisted[-1]:.1f} cm/s after "
            f"{AT_ONCE * len(swim.unresisted)} strides from rest, and "
            f"{1e2 * swim.unresisted_gaining:+.2g} cm/s^2"
        )
    return said


def stride_columns(swim: Swim) -> dict[str, np.ndarray]:
    """The stride, column by column, from its begin; places from the midline's mean at first."""
    steps = swim.search.steps_per_stride
    velocity, resistance, midline = (
        np.asarray(x) for x in (swim.stride.velocity, swim.stride.resistance, swim.stride.midline)
    )
    place = midline - midline[0].mean(axis=1)[:, None]
    return {
        "t_s": np.arange(1.0, steps + 1.0) / (steps * swim.frequency),
        "velocity_x_m_per_s": velocity[:, 0],
        "velocity_y_m_per_s": velocity[:, 1],
        "resistance_x_N": resistance[:, 0],
        "resistance_y_N": resistance[:, 1],
        "power_W": np.asarray(swim.stride.power),
        "head_x_m": place[:, 0, -1],
        "head_y_m": place[:, 1, -1],
        "tip_x_m": place[:, 0, 0],
        "tip_y_m": place[:, 1, 0],
    }


def plot_swim(swim: Swim, path: Path) -> None:
    """Midlines over the stride, along the course; and the speed from rest to the steady one."""
    figure, (above, below) = new_figure(2, 1, figsize=(8, 6), height_ratios=(2, 3))
    midline, steps = np.asarray(swim.stride.midline), swim.search.steps_per_stride
    mean = np.asarray(swim.stride.velocity).mean(axis=0)
    speed = np.hypot(*mean)
    along = mean / speed if speed > 0.0 else np.array([1.0, 0.0])
    x = midline[:, 0] * along[0] + midline[:, 1] * along[1]
    y = -midline[:, 0] * along[1] + midline[:, 1] * along[0]
    x, y = x - x.mean(), y - y.mean()
    for i in range(0, steps, max(1, steps // 12)):
        above.plot(1e3 * x[i], 1e3 * y[i], color=f"{0.75 * (1.0 - i / steps):.3f}", lw=1.2)
    above.plot(1e3 * x[:, -1], 1e3 * y[:, -1], "C3", lw=1.0)
    above.plot(1e3 * x[:, 0], 1e3 * y[:, 0], "C0", lw=1.0)
    above.set_aspect("equal")
    above.set_xlabel("along the course (mm)")
    above.set_ylabel("across (mm)")
    said = "one stride, late midlines darker; red: head, blue: tip of the tail"
    above.set_title(said, fontsize="medium")

    def swum(speeds: np.ndarray, **look: Any) -> None:
        at = AT_ONCE * np.arange(len(speeds) + 1) / swim.frequency
        below.plot(at, 1e2 * np.concatenate([[0.0], speeds]), marker="o", ms=3, lw=1.2, **look)

    swum(swim.from_rest, color="C0", label="from rest")
    if swim.unresisted is not None:
        swum(swim.unresisted, color="0.6", label=f"without {swim.resisting}")
    if swim.found:
        speed = 1e2 * float(swim.performance.speed)
        below.axhline(speed, color="C3", ls="--", lw=1.0, label=f"root: {speed:.2f} cm/s")
    below.set_xlabel("time (s)")
    below.set_ylabel("speed (cm/s)")
    below.legend(fontsize="small")
    save_figure(figure, path)
