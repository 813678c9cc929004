"""Writes the demo's files, and compares its results with the paper's values."""

import dataclasses
from pathlib import Path

import numpy as np

from slider_jax import paper
from slider_jax.channels import SLIDER_CHANNELS, TIME
from slider_jax.io.files import staged, versions, write_csv, write_json
from slider_jax.reproduction.frequency_sweep import (
    FrequencySeries,
    FrequencySweep,
    FrequencySweepSettings,
)
from slider_jax.reproduction.frequency_sweep_figures import (
    stride_in_detail,
    thrust_against_frequency,
)

ASSUMED = {
    "front_chamber, rear_chamber": "positions from the head in m; not given in the paper",
    "amplitude, rear_ratio, phase": "not given in the paper; the demo uses 260 kPa in both chambers"
    " and delays the rear chamber by 0.05 of a stride. These values were chosen so that the mean "
    "thrust is near 60 mN at 4.8 Hz and has its minimum near 1 Hz, so these two results do not "
    "test the model. In the paper, 60 mN are the largest thrust, but here the largest is at 4.0 Hz",
    "damping_time": "2 ms; with the paper's 5e-6 s, vibrations at 30-100 Hz are undamped",
    "EA": "100 kN in body and tail; not given in the paper; strains are below 1e-3",
    "C_d, m_a": "C_d = 4, m_a = 0 below 2 Hz; C_d = 3, m_a = 1 above 3 Hz; linear in between",
}
"""Assumed values of the demo, with reasons."""


def write_frequency_sweep(
    sweep: FrequencySweep, settings: FrequencySweepSettings, folder: Path
) -> None:
    """Writes tables, pictures and settings. If an error occurs, the folder stays unchanged."""
    with staged(folder) as stage:
        write_csv(stage / "sweep.csv", sweep.table)
        thrust_against_frequency(sweep, settings, stage / "thrust_against_frequency.png")
        for frequency, series in sweep.shown.items():
            name = f"{frequency:g}".replace(".", "p") + "Hz"
            readings = {x.column: series.channels[x.name] for x in SLIDER_CHANNELS.values()}
            write_csv(stage / f"series_{name}.csv", {TIME: series.t} | readings)
            stride_in_detail(frequency, series, settings, stage / f"stride_{name}.png")
        record = {
            "settings": dataclasses.asdict(settings),
            "assumed": ASSUMED,
            "seed": None,
            "failed_frequencies_Hz": sweep.table["frequency_Hz"][~sweep.ok],
            "versions": versions(),
        }
        write_json(stage / "settings.json", record)


def _at(sweep: FrequencySweep, name: str, frequency: float) -> float:
    return float(sweep.table[name][np.argmin(np.abs(sweep.table["frequency_Hz"] - frequency))])


def comparison(sweep: FrequencySweep, settings: FrequencySweepSettings) -> str:
    """Returns the demo's table: values of the paper and of this model, and whether they agree."""
    table, f = sweep.table, sweep.table["frequency_Hz"]
    thrust, recoil = 1e3 * table["thrust_mean_N"], 1e3 * table["recoil_peak_N"]
    if np.isnan(thrust).all():
        return "no frequency converged; see settings.json"
    low, top = int(np.nanargmin(thrust)), int(np.nanargmax(thrust))
    least, most = f"{thrust[low]:.1f} mN at {f[low]:g} Hz", f"{thrust[top]:.1f} mN at {f[top]:g} Hz"
    at, stated, slope = paper.PEAK_AT, 1e3 * paper.PEAK_THRUST, 1e3 * paper.ROLL_OFF
    near = 1e3 * _at(sweep, "thrust_mean_N", at)
    spread = 1e3 * _at(sweep, "thrust_std_of_strides_N", at)
    fall = (thrust[top] - thrust[-1]) / (f[-1] - f[top]) if top < len(f) - 1 else np.nan
    rows = [
        ("", "paper", "here", ""),
        (
            "smallest mean thrust",
            f"negative, near {paper.MINIMUM_NEAR:g} Hz",
            least,
            _verdict(thrust[low] < 0.0 and _near_hz(f[low], paper.MINIMUM_NEAR)),
        ),
        (
            "largest mean thrust",
            f"near {stated:.0f} mN at {at:g} Hz",
            most,
            _verdict(_near(thrust[top], stated, paper.NEAR * stated) and _near_hz(f[top], at)),
        ),
        (
            f"roll-off from it to {f[-1]:g} Hz",
            f"about {slope:.0f} mN/Hz",
            f"{fall:.0f} mN/Hz",
            "not available"
            if np.isnan(fall)
            else _verdict(_near(fall, slope, paper.ABOUT * slope)),
        ),
    ]
    for frequency, share in paper.RECOIL_SHARES.items():
        if frequency in sweep.shown and sweep.ok[np.argmin(np.abs(f - frequency))]:
            found = _recoil_share(sweep.shown[frequency], settings)
            rows.append(
                (
                    f"recoil above {1e3 * paper.RECOIL_THERE:.0f} mN at {frequency:g} Hz",
                    f"{100 * share:.0f} % of a stride",
                    f"{100 * found:.0f} %",
                    _verdict(_near(found, share, paper.NEAR_SHARE)),
                )
            )
    widths = [max(len(row[column]) for row in rows) for column in range(4)]
    lines = ["  ".join(x.ljust(w) for x, w in zip(row, widths, strict=True)) for row in rows]
    negative = f[thrust < 0.0]
    notes = [
        f"At {at:g} Hz, the mean thrust is {near:.1f} mN (s.d. of strides {spread:.1f}). The "
        f"largest recoil is {np.nanmax(recoil):.0f} mN at {f[int(np.nanargmax(recoil))]:g} Hz.",
        f"Mean thrust is negative from {negative.min():g} to {negative.max():g} Hz."
        if negative.size
        else "Mean thrust is not negative at any frequency.",
        f"Each mean covers {settings.strides - settings.transient} strides after "
        f"{settings.transient} transient strides. Pressures, chamber positions, damping and axial "
        "stiffness are assumed (settings.json). Amplitude and delay were chosen for a minimum near "
        "1 Hz and about 60 mN at 4.8 Hz, so these do not test the model. `slider published --all` "
        "compares every statement of the paper.",
        f"A value agrees within {100 * paper.NEAR:.0f} % (largest thrust), "
        f"{100 * paper.ABOUT:.0f} % (roll-off), {paper.NEAR_HZ:g} Hz, and "
        f"{100 * paper.NEAR_SHARE:.0f} % of a stride. These tolerances are in slider_jax/paper.py.",
    ]
    if not sweep.ok.all():
        notes.append(f"Not converged: {', '.join(f'{x:g} Hz' for x in f[~sweep.ok])}.")
    return "\n".join([*(line.rstrip() for line in lines), "", *notes])


def _near(value: float, stated: float, tolerance: float) -> bool:
    return abs(value - stated) <= tolerance * (1.0 + 1e-9)


def _near_hz(frequency: float, stated: float) -> bool:
    return _near(frequency, stated, paper.NEAR_HZ)


def _recoil_share(series: FrequencySeries, settings: FrequencySweepSettings) -> float:
    """Returns the fraction of the steady strides with a recoil above `paper.RECOIL_THERE`."""
    steady = series.channels["recoil"][settings.transient * settings.steps_per_stride :]
    return float(np.mean(np.abs(steady) > paper.RECOIL_THERE))


def _verdict(agrees: bool) -> str:
    return "agrees" if agrees else "differs"
