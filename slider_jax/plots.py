"""Pictures of a simulated trial: what the sensors read, and midlines over the last stride."""

from pathlib import Path

import numpy as np

from slider_jax.simulate import Run

CHANNELS = (
    ("p_front_Pa", "front pressure (kPa)", 1e-3),
    ("p_rear_Pa", "rear pressure (kPa)", 1e-3),
    ("thrust_N", "thrust (mN)", 1e3),
    ("recoil_N", "recoil (N)", 1.0),
    ("tip_m", "tip, lateral (mm)", 1e3),
)
"""Column, label with unit, factor from SI."""


def _figure(*args, **kwargs):
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt.subplots(*args, layout="constrained", **kwargs)


def _close(figure, path: Path) -> None:
    import matplotlib.pyplot as plt

    figure.savefig(path, dpi=150)
    plt.close(figure)


def title(run: Run) -> str:
    """What was done in the trial, in a line."""
    trial = run.trial
    stem = Path(trial.file).stem
    if trial.waveform == "recorded":
        drive = f"recorded drive {trial.drive_file}"
    else:
        drive = (
            f"{trial.waveform} {trial.frequency:g} Hz, {1e-3 * (trial.amplitude or 0.0):g} kPa, "
            f"rear {trial.rear_ratio:g} at {trial.phase:g} period"
        )
    return f"{stem}: {drive}, tow {trial.tow_speed:g} m/s"


def plot_run(run: Run, measured: dict[str, np.ndarray] | None, folder: Path) -> None:
    """Write `<stem>.png` (time series, measured ones under them) and `<stem>_midlines.png`."""
    stem = Path(run.trial.file).stem
    plot_series(run, measured, folder / f"{stem}.png")
    plot_midlines(run, folder / f"{stem}_midlines.png")


def plot_series(run: Run, measured: dict[str, np.ndarray] | None, path: Path) -> None:
    """Pressures, thrust, recoil and tip against time; measured samples, if any, in grey."""
    figure, axes = _figure(len(CHANNELS), 1, figsize=(9, 10), sharex=True)
    for ax, (name, label, factor) in zip(axes, CHANNELS, strict=True):
        if measured is not None and name in measured:
            there = np.isfinite(measured[name])
            ax.plot(
                measured["t_s"][there],
                factor * measured[name][there],
                color="0.65",
                lw=1.8,
                label="measured",
            )
        ax.plot(run.columns["t_s"], factor * run.columns[name], "C0", lw=1.0, label="simulated")
        ax.set_ylabel(label)
        ax.axhline(0.0, color="k", lw=0.4)
        ax.margins(x=0.0)
    if measured is not None and len(measured) > 1:
        axes[0].legend(loc="upper right", ncols=2, fontsize="small")
    axes[-1].set_xlabel("time (s)")
    figure.suptitle(title(run), fontsize="medium")
    _close(figure, path)


def last_stride(run: Run, frames: int, closed: bool = False) -> np.ndarray:
    """Indices of `frames` steps spread evenly over the last stride, or the last second without one.

    `closed` includes the stride's end, which is its beginning again.
    """
    half = run.clock.half_period
    length = 2 * half if half else round(1.0 / run.clock.h)
    begin = max(0, run.clock.steps - length)
    return np.linspace(begin, run.clock.steps, frames, endpoint=closed).round().astype(int)


def plot_midlines(run: Run, path: Path) -> None:
    """Midlines over the last stride in the clamp's frame, dark to light, and the tip's path."""
    import matplotlib

    steps = last_stride(run, 16)
    figure, ax = _figure(figsize=(8, 4.5))
    colours = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.95, len(steps)))
    for index, colour in zip(steps, colours, strict=True):
        ax.plot(*(1e3 * run.series["midline"][index]), color=colour, lw=1.2)
    path_steps = last_stride(run, 200, closed=True)
    ax.plot(
        *(1e3 * run.series["midline"][path_steps, :, 0].T), "k:", lw=1.0, label="path of the tip"
    )
    ax.plot(0.0, 0.0, "ks", ms=7, label="clamp")
    ax.set_xlabel("x, forward from the clamp (mm)")
    ax.set_ylabel("y, lateral (mm; stretched)")
    ax.legend(loc="upper right", fontsize="small")
    t = run.t[steps]
    scale = matplotlib.cm.ScalarMappable(
        matplotlib.colors.Normalize(t[0], t[-1]), matplotlib.colormaps["viridis"]
    )
    figure.colorbar(scale, ax=ax, label="time (s)")
    ax.set_title(title(run), fontsize="medium")
    _close(figure, path)
