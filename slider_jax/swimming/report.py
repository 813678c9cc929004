"""Writes the table, the summary and the picture of free swimming."""

from pathlib import Path
from typing import Any

import jax
import numpy as np

from slider_jax.io.figures import new_figure, save_figure
from slider_jax.swimming.free_swim import AT_ONCE, Swim
from slider_jax.swimming.paper_optimum import MEASURED_GAIT, PAPER_GAIT, Published
from slider_jax.swimming.swim_in_space import SwimInSpace

ROWS = (
    ("speed_m_per_s", "speed U", "cm/s", 1e2),
    ("wavelength_m", "wavelength lambda", "mm", 1e3),
    ("wave_speed_m_per_s", "wave speed V", "cm/s", 1e2),
    ("travelling_index", "travelling index", "", 1.0),
    ("froude_efficiency", "Froude efficiency T U/P", "", 1.0),
    ("slender_efficiency", "slender-body efficiency, (1+U/V)/2", "", 1.0),
    ("force_efficiency_N_per_W", "force efficiency T/P", "N/W", 1.0),
    ("tail_amplitude_m", "tail amplitude A_t", "mm", 1e3),
    ("strouhal", "Strouhal number 2 A_t f/U", "", 1.0),
    ("tail_slope", "tail slope A_t/(lambda/4)", "", 1.0),
    ("shape_wavelength_m", "wavelength of the shape", "mm", 1e3),
    ("shape_tail_slope", "tail slope from the shape", "", 1.0),
    ("power_W", "power P", "W", 1.0),
    ("cost_of_transport", "cost of transport P/(m g U)", "", 1.0),
    ("head_amplitude_m", "head amplitude", "mm", 1e3),
    ("turning_rad_per_stride", "turning, per stride", "mrad", 1e3),
)
"""Name in `swim_record`, label, displayed unit, factor from the SI unit to the displayed unit."""

SPATIAL_ROWS = (
    ("speed_m_per_s", "speed U", "cm/s", 1e2),
    ("rising_m_per_s", "upward part of the speed", "cm/s", 1e2),
    ("turning_rad_per_s", "turning, seen from above", "rad/s", 1.0),
    ("rolling_rad_per_s", "rolling", "rad/s", 1.0),
    ("roll_rad", "mean roll", "rad", 1.0),
    ("pitch_rad", "mean pitch, head up", "rad", 1.0),
    ("tail_amplitude_m", "tail amplitude A_t, in the plane", "mm", 1e3),
    ("tail_amplitude_out_of_plane_m", "tail amplitude, out of the plane", "mm", 1e3),
    ("tail_twist_rad", "largest twist of the tail", "rad", 1.0),
    ("head_amplitude_m", "head amplitude, in the plane", "mm", 1e3),
    ("head_amplitude_out_of_plane_m", "head amplitude, out of the plane", "mm", 1e3),
    ("power_W", "power P", "W", 1.0),
)
"""`ROWS` for `spatial_swim_record`."""


def value_lines(record: dict[str, Any], rows: tuple[tuple[str, str, str, float], ...]) -> list[str]:
    """Returns a line with label, unit and value for each of `rows`; see `ROWS` for the columns."""
    return [
        f"{label + (f' ({unit})' if unit else ''):36}{factor * record[name]:10.4g}"
        for name, label, unit, factor in rows
    ]


def swim_table(row: dict[str, Any], published: dict[str, Published]) -> str:
    """Returns the table of the quantities, with the paper's values if `published` contains any."""
    head = f"{'':36}{'here':>10}"
    if published:
        head += f"{'paper model':>14}{'ratio':>8}{'measured':>12}{'ratio':>8}"
    lines = [head]
    for line, (name, _, _, factor) in zip(value_lines(row, ROWS), ROWS, strict=True):
        for value, width in zip(published.get(name, ()), (14, 12), strict=False):
            line += f"{factor * value:{width}.4g}{row[name] / value:8.2f}"
        lines.append(line.rstrip())
    if published:
        model, measured = (1e3 * x.tail_length for x in (PAPER_GAIT, MEASURED_GAIT))
        lines.append(
            f"the tail of the paper's model has {model:.0f} mm, as here; that of its experiment "
            f"{measured:.0f} mm"
        )
    return "\n".join(lines)


def swim_summary(swim: Swim) -> list[str]:
    """Returns sentences about the steady speed, and about the speed without resistance."""
    end = swim.from_rest[-1]
    count = AT_ONCE * len(swim.from_rest)
    root, rest = f"{1e2 * float(swim.performance.speed):.2f} cm/s", f"{1e2 * end:.2f} cm/s"
    gaining = f"{1e2 * swim.gaining:+.2g} cm/s^2"
    if swim.found and swim.repeats:
        off = f"{1e2 * swim.difference:+.2f} %"
        lines = [
            f"steady speed {root} by root finding in {swim.strides} strides; from rest, constant "
            f"{rest} after {count} strides (difference {off})"
        ]
    elif swim.found:
        lines = [
            f"steady speed {root} by root finding in {swim.strides} strides; from rest, {rest} "
            f"after {count} strides with an acceleration of {gaining}"
        ]
    elif swim.repeats:
        lines = [f"root finding did not converge; from rest, constant {rest} after {count} strides"]
    else:
        lines = [
            f"no steady speed: from rest, {rest} after {count} strides with an acceleration of "
            f"{gaining}; "
            + (
                f"{swim.resisting} resists too little, or the motion is not periodic"
                if swim.resisting
                else "no effect resists motion along the body: add an effect such as head_drag"
            )
        ]
    if swim.unresisted is not None:
        lines.append(
            f"without {swim.resisting}: {1e2 * swim.unresisted[-1]:.1f} cm/s after "
            f"{AT_ONCE * len(swim.unresisted)} strides from rest, with an acceleration of "
            f"{1e2 * swim.unresisted_gaining:+.2g} cm/s^2"
        )
    return lines


def stride_columns(swim: Swim) -> dict[str, np.ndarray]:
    """Returns the columns of a stride's table; the origin is the mean of the first midline."""
    steps = swim.search.steps_per_stride
    stride = jax.tree.map(np.asarray, swim.stride)
    place = stride.midline - stride.midline[0].mean(axis=1)[:, None]
    return {
        "t_s": np.arange(1.0, steps + 1.0) / (steps * swim.frequency),
        "velocity_x_m_per_s": stride.velocity[:, 0],
        "velocity_y_m_per_s": stride.velocity[:, 1],
        "resistance_x_N": stride.resistance[:, 0],
        "resistance_y_N": stride.resistance[:, 1],
        "power_W": stride.power,
        "head_x_m": place[:, 0, -1],
        "head_y_m": place[:, 1, -1],
        "tip_x_m": place[:, 0, 0],
        "tip_y_m": place[:, 1, 0],
    }


def plot_swim(swim: Swim, path: Path) -> None:
    """Plots the midlines of one stride, and the speed against time while swimming from rest."""
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
    above.set(xlabel="along the course (mm)", ylabel="across (mm)")
    title = "one stride, later midlines are darker; red: head, blue: tip of the tail"
    above.set_title(title, fontsize="medium")

    def plot_speeds(speeds: np.ndarray, **style: Any) -> None:
        times = AT_ONCE * np.arange(len(speeds) + 1) / swim.frequency
        below.plot(times, 1e2 * np.concatenate([[0.0], speeds]), marker="o", ms=3, lw=1.2, **style)

    plot_speeds(swim.from_rest, color="C0", label="from rest")
    if swim.unresisted is not None:
        plot_speeds(swim.unresisted, color="0.6", label=f"without {swim.resisting}")
    if swim.found:
        speed = 1e2 * float(swim.performance.speed)
        below.axhline(speed, color="C3", ls="--", lw=1.0, label=f"steady: {speed:.2f} cm/s")
    below.set(xlabel="time (s)", ylabel="speed (cm/s)")
    below.legend(fontsize="small")
    save_figure(figure, path)


def spatial_swim_summary(swim: SwimInSpace, row: dict[str, Any]) -> list[str]:
    """Returns the table of the quantities and a sentence about the steady speed."""
    count, speed = len(swim.velocity), f"{1e2 * row['speed_m_per_s']:.2f} cm/s"
    if swim.repeats:
        text = f"steady: after {count} strides from rest, strides repeat at {speed}"
    else:
        text = f"not steady: after {count} strides from rest, strides still change; speed {speed}"
        if not swim.resisting:
            text += "; no effect resists motion along the body: add an effect such as head_drag"
    return [*value_lines(row, SPATIAL_ROWS), text]


def spatial_stride_columns(swim: SwimInSpace) -> dict[str, np.ndarray]:
    """Returns the columns of the last stride's table; the origin is the head at the start."""
    steps, stride = swim.search.steps_per_stride, swim.stride
    columns = {"t_s": np.arange(1.0, steps + 1.0) / (steps * swim.frequency)}
    for name, series in (
        ("velocity_{}_m_per_s", stride.velocity),
        ("head_{}_m", stride.midline[:, :, -1]),
        ("tip_{}_m", stride.midline[:, :, 0]),
    ):
        columns |= {name.format(x): np.asarray(series[:, i]) for i, x in enumerate("xyz")}
    twist, power = np.asarray(stride.tail_twist), np.asarray(stride.power)
    return columns | {"tail_twist_rad": twist, "power_W": power}


def plot_spatial_swim(swim: SwimInSpace, path: Path) -> None:
    """Plots the head's path, the speed, and the attitude against time."""
    figure, axes = new_figure(2, 2, figsize=(9, 6))
    (above, speed), (side, attitude) = axes
    x, y, z = np.concatenate([np.zeros((1, 3)), swim.head]).T
    for axis, up, label in ((above, y, "y (m)"), (side, z, "z (m)")):
        axis.plot(x, up, "C0", lw=1.2)
        axis.plot(x[0], up[0], "C0o", ms=4)
        axis.set(xlabel="x (m)", ylabel=label)
        axis.axis("equal")
    above.set_title("path of the head from above; dot: start", fontsize="medium")
    side.set_title("path of the head from the side", fontsize="medium")
    t = np.arange(1.0, len(swim.velocity) + 1.0) / swim.frequency
    speed.plot(t, 1e2 * np.linalg.norm(swim.velocity, axis=1), "C0", label="speed")
    speed.plot(t, 1e2 * swim.velocity[:, 2], "C1", label="upward part")
    speed.set(xlabel="time (s)", ylabel="mean speed in a stride (cm/s)")
    for name, angle in vars(swim.attitude).items():
        attitude.plot(t, np.unwrap(np.asarray(angle)), label=name)
    attitude.set(xlabel="time (s)", ylabel="mean angle in a stride (rad)")
    for axis in (speed, attitude):
        axis.legend(fontsize="small")
    save_figure(figure, path)
