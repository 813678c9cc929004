"""Plots a simulated trial: the sensors' readings, and midlines of the last stride."""

from pathlib import Path

import numpy as np

from slider_jax.experiment.drive import drive_text
from slider_jax.io.figures import new_figure, save_figure
from slider_jax.simulation.trial import TrialRun


def run_title(run: TrialRun) -> str:
    """Returns the trial's drive and tow speed as one line."""
    trial = run.trial
    if trial.waveform == "recorded":
        drive = f"recorded drive {trial.drive_file}"
    else:
        drive = f"{trial.waveform} {trial.frequency:g} Hz"
        if chambers := len(run.prepared.channels.pressures):
            text = drive_text(trial, chambers)
            drive += f", {1e-3 * (trial.amplitude or 0.0):g} kPa{text and f', {text}'}"
    support = "free" if trial.support == "free" else f"tow {trial.tow_speed:g} m/s"
    return f"{Path(trial.file).stem}: {drive}, {support}"


def plot_run(run: TrialRun, rmse: dict[str, float] | None, folder: Path) -> None:
    """Writes `<stem>.png` (simulated and measured time series) and `<stem>_midlines.png`.

    `rmse` is the root mean square of simulated minus measured readings by column, in SI units.
    """
    stem = Path(run.trial.file).stem
    plot_series(run, rmse or {}, folder / f"{stem}.png")
    plot_midlines(run, folder / f"{stem}_midlines.png")


def plot_series(run: TrialRun, rmse: dict[str, float], path: Path) -> None:
    """Plots the simulated channels against time; measured samples are grey."""
    measured = run.prepared.measured or {}
    free = run.trial.support == "free"  # nothing holds the head, so the forces on it are zero
    channels = [x for x in run.prepared.channels.values() if not (free and x.kind == "force")]
    size = (9, 2.0 * len(channels))
    figure, axes = new_figure(len(channels), 1, figsize=size, sharex=True)
    for ax, channel in zip(axes, channels, strict=True):
        name, unit, factor = channel.column, channel.plot_unit, channel.plot_factor
        ax.plot(run.columns["t_s"], factor * run.columns[name], "C0", lw=1.0, label="simulated")
        if name in rmse:
            finite = np.isfinite(measured[name])
            t, values = measured["t_s"][finite], factor * measured[name][finite]
            ax.plot(t, values, color="0.65", lw=1.8, zorder=1.5, label="measured")
            text = f"rms difference {factor * rmse[name]:.3g} {unit}"
            ax.set_title(text, fontsize="small", loc="right")
        ax.set_ylabel(f"{channel.label} ({unit})")
        ax.axhline(0.0, color="k", lw=0.4)
        ax.margins(x=0.0)
    if rmse:
        above = {"bbox_to_anchor": (0.0, 1.0), "ncols": 2, "fontsize": "small", "frameon": False}
        drawn = next(ax for ax in axes if len(ax.get_lines()) > 2)
        handles, labels = drawn.get_legend_handles_labels()
        axes[0].legend(handles, labels, loc="lower left", **above)
    axes[-1].set_xlabel("time (s)")
    figure.suptitle(run_title(run), fontsize="medium")
    save_figure(figure, path)


def last_strides(run: TrialRun, frames: int, strides: int = 1, closed: bool = False) -> np.ndarray:
    """Returns `frames` evenly spaced step indices of the last `strides` strides.

    For a recorded drive, a stride is one second. If `closed`, the indices include the last step.
    """
    begin = max(0, run.grid.steps - strides * run.grid.stride)
    return np.linspace(begin, run.grid.steps, frames, endpoint=closed).round().astype(int)


def plot_midlines(run: TrialRun, path: Path) -> None:
    """Plots midlines of the last stride relative to the head, and the tip's path.

    A robot in three dimensions is shown from above, and below that from the side.
    """
    import matplotlib

    steps = last_strides(run, 16)
    line = 1e3 * run.series["midline"]
    panels, height = line.shape[1] - 1, 4.5 if line.shape[1] == 2 else 7.0
    figure, axes = new_figure(panels, 1, figsize=(8, height), squeeze=False, sharex=True)
    colours = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.95, len(steps)))
    head = "head" if run.trial.support == "free" else "clamp"
    for ax, across in zip(axes[:, 0], (1, 2), strict=False):
        for index, colour in zip(steps, colours, strict=True):
            ax.plot(*line[index][[0, across]], color=colour, lw=1.2)
        tip = line[last_strides(run, 200, closed=True), :, 0]
        ax.plot(*tip[:, [0, across]].T, "k:", lw=1.0, label="path of the tip")
        ax.plot(0.0, 0.0, "ks", ms=7, label=head)
        ax.set_ylabel(f"{('y, lateral', 'z, upward')[across - 1]} (mm; scale enlarged)")
    axes[-1, 0].set_xlabel(f"x, forward from the {head} (mm)")
    axes[0, 0].legend(loc="upper right", fontsize="small")
    times = matplotlib.colors.Normalize(run.t[steps[0]], run.t[steps[-1]])
    scale = matplotlib.cm.ScalarMappable(times, "viridis")
    figure.colorbar(scale, ax=axes, label="time (s)")
    axes[0, 0].set_title(run_title(run), fontsize="medium")
    save_figure(figure, path)
