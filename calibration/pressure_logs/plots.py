"""Plots the identification of the pressure lag, and the simulation of a robot driven by a log."""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from calibration.pressure_logs.identify import Identification, LogResult, rms
from calibration.pressure_logs.read import PA_PER_PSI, ManifoldLog, psi
from slider_jax.io.figures import new_figure, save_figure

_COMMAND, _MEASURED, _BEFORE, _AFTER = "0.55", "black", "tab:orange", "tab:blue"
_FILL, _VENT = "tab:red", "tab:green"


def plot_log(result: LogResult, reference_k: float, path: Path) -> None:
    """Plots command, measured pressure, free runs and residuals of the first 2.5 cycles."""
    log = result.log
    here = log.t <= 2.5 / log.frequency
    t, measured = log.t[here], psi(log.pressure)[here]
    figure, (top, low) = new_figure(2, 1, figsize=(9.0, 6.0), sharex=True, height_ratios=[3, 2])
    after = f"lag, k = {1e3 * result.k.value:.0f} ms (fitted to this log)"
    before = f"lag, k = {1e3 * reference_k:.0f} ms (paper's)"
    top.plot(t, psi(log.command)[here], "--", color=_COMMAND, label="command")
    top.plot(t, measured, color=_MEASURED, lw=1.8, label="measured")
    for residual, colour, label in (
        (result.before[here], _BEFORE, before),
        (result.after[here], _AFTER, after),
    ):
        top.plot(t, measured - residual, color=colour, label=label)
        low.plot(t, residual, color=colour, lw=1.0)
    floor = 2.0 * result.shape.floor
    low.axhspan(-floor, floor, color="0.85", label="two standard deviations of sensor noise")
    low.axhline(0.0, color="0.4", lw=0.7)
    top.set_ylabel("gauge pressure (psi)")
    low.set_ylabel("measured - free run (psi)")
    low.set_xlabel("time (s)")
    top.set_title(
        f"{log.path.name}, {log.frequency:g} Hz. RMSE of {log.cycles:.0f} cycles: "
        f"{rms(result.before):.2f} psi (paper's k), {rms(result.after):.2f} psi (fitted k). "
        f"Noise: {result.shape.floor:.2f} psi",
        fontsize=10,
    )
    _legend_below(top, 4)
    low.legend(loc="upper right", fontsize=8)
    save_figure(figure, path)


def _legend_below(axes, columns: int) -> None:
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.02), ncols=columns, fontsize=8)


def plot_phase(found: Identification, path: Path) -> None:
    """Plots each log's residual against the phase of the command. The colour is the open valve."""
    count = len(found.logs)
    across = min(count, 4)
    down = math.ceil(count / across)
    size = 3.1 * across + 1.2, 2.6 * down + 1.0
    figure, axes = new_figure(down, across, figsize=size, sharex=True, sharey=True, squeeze=False)
    for axis in axes.flat[count:]:
        axis.axis("off")
    for axis, result in zip(axes.flat, found.logs, strict=False):
        log = result.log
        # Phase in cycles since the command rose through its mean.
        turn = 2.0 * math.pi * log.frequency * log.t
        x = log.command - log.command.mean()
        a, b = (x * np.cos(turn)).sum(), (x * np.sin(turn)).sum()
        phase = (turn + math.atan2(a, b)) / (2.0 * math.pi) % 1.0
        filling = log.command > log.pressure
        for here, colour, label in (
            (filling, _FILL, "fill valve open"),
            (~filling, _VENT, "vent valve open"),
        ):
            axis.plot(phase[here], result.after[here], ".", ms=1.2, color=colour, label=label)
        axis.axhline(0.0, color="0.4", lw=0.7)
        axis.set_title(f"{log.frequency:g} Hz, k = {1e3 * result.k.value:.0f} ms", fontsize=9)
        axis.set_xlim(0.0, 1.0)
    for axis in axes[:, 0]:
        axis.set_ylabel("measured - free run (psi)", fontsize=9)
    for axis in axes.flat[max(0, count - across) : count]:  # bottom axis of each column
        axis.tick_params(labelbottom=True)
        axis.set_xlabel("phase of the command (cycles)", fontsize=9)
    handles, labels = axes.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=2, markerscale=8, fontsize=9)
    figure.suptitle("Residual with the k of each log. At phase 0, the command rises past its mean.",
                    fontsize=10, x=0.01, ha="left")  # fmt: skip
    save_figure(figure, path)


def plot_rate(found: Identification, path: Path) -> None:
    """Plots all residuals against the rate of the pressure, for rising and for falling pressure."""
    from matplotlib import colormaps

    figure, axes = new_figure(1, 2, figsize=(10.0, 4.4), sharey=True)
    colours = colormaps["viridis"](np.linspace(0.0, 0.95, len(found.logs)))
    for result, colour in zip(found.logs, colours, strict=True):
        log, p = result.log, psi(result.log.pressure)
        rate = (p[20:] - p[:-20]) / (log.t[20:] - log.t[:-20])
        residual = result.after[10:-10]
        for axis, sign in zip(axes, (1.0, -1.0), strict=True):
            here = sign * rate > 0.0
            if not here.any():
                continue
            edges = np.unique(np.quantile(rate[here], np.linspace(0.0, 1.0, 16)))
            bins = np.clip(np.searchsorted(edges, rate[here]) - 1, 0, max(len(edges) - 2, 0))
            x, y = ([v[here][bins == i].mean() for i in np.unique(bins)] for v in (rate, residual))
            axis.plot(x, y, ".-", color=colour, label=f"{log.frequency:g} Hz")
    for axis, title in zip(axes, ("pressure rising", "pressure falling"), strict=True):
        axis.axhline(0.0, color="0.4", lw=0.7)
        axis.set_xlabel("rate of the measured pressure (psi/s)")
        axis.set_title(title, fontsize=10)
    axes[1].invert_xaxis()
    axes[0].set_ylabel("mean of measured - free run (psi)")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center", fontsize=8)
    save_figure(figure, path)


def plot_k(found: Identification, reference_k: float, path: Path) -> None:
    """Plots k and RMSE of each log. k is estimated from fit, gain, phase, filling and venting."""
    figure, (left, middle, right) = new_figure(1, 3, figsize=(14.0, 4.6))
    f = np.array([x.log.frequency for x in found.logs])
    k = 1e3 * np.array([[x.k.value, x.k.low, x.k.high] for x in found.logs]).T
    fixed = np.array([x.fixed for x in found.logs])
    for axis in (left, middle):
        axis.axhline(1e3 * reference_k, color=_BEFORE, label=f"paper: {1e3 * reference_k:.0f} ms")
        axis.set_yscale("log")
        axis.set_ylim(30.0, 1500.0)
        axis.set_ylabel("k (ms)")
    left.axhspan(1e3 * found.k.low, 1e3 * found.k.high, color=_AFTER, alpha=0.15)
    left.axhline(1e3 * found.k.value, color=_AFTER, label=f"all logs: {1e3 * found.k.value:.0f} ms")
    for here, mark, label in ((fixed, "o", "one log"), (~fixed, "x", "one log, undetermined")):
        if here.any():
            error = np.stack([k[0] - k[1], k[2] - k[0]])[:, here]
            left.errorbar(f[here], k[0, here], error, fmt=mark, color=_MEASURED, capsize=3,
                          label=label)  # fmt: skip
    left.set_title("least-squares k with 95 % intervals", fontsize=10)
    shapes = [x.shape for x in found.logs]
    for values, style, label in (
        ([s.k_filling for s in shapes], ("^", _FILL), "pressure error / rate while filling"),
        ([s.k_venting for s in shapes], ("v", _VENT), "pressure error / rate while venting"),
        ([s.measured.k_of_gain for s in shapes], ("s", "tab:purple"), "gain of the fundamental"),
        ([s.measured.k_of_phase for s in shapes], ("D", "tab:brown"), "phase of the fundamental"),
    ):
        middle.plot(f, 1e3 * np.array(values), style[0] + "-", color=style[1], label=label)
    middle.set_title("k estimated from parts of the measurement", fontsize=10)
    for values, style, label in (
        ([rms(x.before) for x in found.logs], ("o", _BEFORE), f"lag, {1e3 * reference_k:.0f} ms"),
        ([rms(x.pooled) for x in found.logs], ("s", "tab:cyan"), "lag, common k of all logs"),
        ([rms(x.after) for x in found.logs], ("o", _AFTER), "lag, each log's own k"),
        ([x.rms_held for x in found.logs], ("_", "0.5"), "constant pressure of the first sample"),
        ([s.floor for s in shapes], ("o", "0.2"), "white noise of the sensor"),
    ):
        right.plot(f, values, style[0] + "-", color=style[1], label=label)
    right.set_yscale("log")
    right.set_ylabel("free-run RMSE (psi)")
    right.set_title("free-run RMSE of each log", fontsize=10)
    for axis in (left, middle, right):
        axis.set_xlabel("drive frequency (Hz)")
        axis.grid(alpha=0.25, which="both")
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), fontsize=8, ncols=2)
    save_figure(figure, path)


def plot_driven(log: ManifoldLog, columns: Mapping[str, np.ndarray], path: Path) -> None:
    """Plots a simulation of the robot driven by a log: pressure, forces at the clamp, and tip."""
    figure, axes = new_figure(4, 1, figsize=(9.0, 8.5), sharex=True)
    t = columns["t_s"]
    axes[0].plot(log.t, log.command_Pa / 1e3, "--", color=_COMMAND, label="command")
    axes[0].plot(log.t, log.pressure_Pa / 1e3, color=_MEASURED, lw=0.9, label="measured")
    axes[0].plot(t, columns["p_front_Pa"] / 1e3, color=_AFTER, label="simulated, both chambers")
    axes[0].set_ylabel("gauge pressure (kPa)")
    _legend_below(axes[0], 3)
    for axis, name, scale, label in (
        (axes[1], "thrust_N", 1e3, "thrust (mN)"),
        (axes[2], "recoil_N", 1e3, "recoil (mN)"),
        (axes[3], "tip_m", 1e3, "tip (mm)"),
    ):
        values = scale * columns[name]
        axis.plot(t, values, color=_AFTER, lw=0.9)
        axis.set_ylabel(label)
        # The limits of the axis ignore the first cycle, because its transient is too large.
        later = values[t >= min(1.0 / log.frequency, 0.5 * t[-1])]
        margin = 0.15 * max(np.ptp(later), 1e-9)
        axis.set_ylim(later.min() - margin, later.max() + margin)
    axes[3].set_xlabel("time (s). The transient in the first cycle is partly outside the plot.")
    axes[0].set_title(
        f"{log.path.name}, {log.frequency:g} Hz: pressure error "
        f"{rms(columns['p_front_Pa'] - log.pressure_Pa) / PA_PER_PSI:.2f} psi rms",
        fontsize=10,
    )
    save_figure(figure, path)
