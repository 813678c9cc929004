"""Reads single numbers, such as the frequency of the largest thrust, from simulated quantities."""

import numpy as np

from slider_jax import paper
from slider_jax.beam.parameters import SLIDER
from slider_jax.reproduction.design_maps import curve_maximum
from slider_jax.statements.assumptions import Assumptions
from slider_jax.statements.quantities import (
    NEIGHBOURS,
    PHASES,
    Quantities,
    StatementSettings,
    gaits,
)
from slider_jax.swimming.paper_optimum import PAPER_GAIT

SLOW = 1.0
"""Frequency [Hz] of the paper's Fig. 5."""
NAMES = tuple(gaits(Assumptions()))


def facts(x: Quantities, at: StatementSettings) -> dict[str, float]:
    """Returns the numbers that `statements.SIMULATED` uses, by name. NaN: not available."""
    alone = {"static_tip_m": float(x.static_tip), "pressure_ratio": float(x.pressure_ratio)}
    found = alone | _of_sweep(x, np.asarray(at.frequencies)) | _of_swims(x)
    return {name: float(value) for name, value in found.items()}


def _of_sweep(x: Quantities, f: np.ndarray) -> dict[str, float]:
    n = len(f)
    thrust, tip, share = (
        np.asarray(y) for y in (x.sweep.thrust, x.sweep.tip_half_range, x.sweep.recoil_share)
    )
    mean = thrust[:n]

    def at(values: np.ndarray, frequency: float) -> float:
        return values[np.argmin(np.abs(f - frequency))]

    # A missing value may hide an extremum, so then there is none.
    whole = mean if np.isfinite(mean).all() else np.full(n, np.nan)
    least, most = curve_maximum(f, -whole), curve_maximum(f, whole)
    between = np.diff(whole[(f >= least.x) & (f <= most.x)])
    fall = (most.y - whole[-1]) / (f[-1] - most.x) if most.x < f[-1] else np.nan
    peak_thrust, peak_tip = at(mean, paper.PEAK_AT), at(tip[:n], paper.PEAK_AT)
    (_, less, none), (more_drag, less_mass, _) = thrust[n:], tip[n:]
    return {
        "sweep_minimum_Hz": least.x,
        "sweep_peak_Hz": most.x,
        "sweep_peak_N": most.y,
        "least_rise_N": between.min() if between.size else np.nan,
        "roll_off_N_per_Hz": fall,
        "thrust_1_Hz_N": at(mean, SLOW),
        "thrust_4p8_Hz_N": peak_thrust,
        "thrust_without_m_a_N": none,
        "recoil_share_1_Hz": at(share[:n], SLOW),
        "recoil_share_4p8_Hz": at(share[:n], paper.PEAK_AT),
        "tip_ratio": peak_tip / at(tip[:n], SLOW),
        "tip_by_C_d": more_drag / peak_tip - 1.0,
        "tip_by_m_a_over_C_d": abs(less_mass - peak_tip) / abs(more_drag - peak_tip),
        "thrust_by_m_a_N": np.min([peak_thrust - less, less - none]),
        "settling_N": np.max(np.abs(np.asarray(x.sweep.change)[:n])),
    }


def _of_swims(x: Quantities) -> dict[str, float]:
    swims = {
        name: {k: float(v[i]) for k, v in vars(x.swims).items()} for i, name in enumerate(NAMES)
    }
    best, longer, f = swims["optimum"], swims["tail_length 0.07"], float(PAPER_GAIT.frequency)
    speed, wavelength = best["speed"], best["shape_wavelength"]
    phases = np.array([swims[f"7d {p:g}"]["speed"] for p in PHASES])
    at_phase = dict(zip(PHASES, phases, strict=True))
    whole = phases if np.isfinite(phases).all() else np.full(len(phases), np.nan)
    top = curve_maximum(np.array(PHASES), whole)

    def gain(name: str) -> float:
        """Largest gain of the speed [m/s] by a change of one variable."""
        return np.max([swims[f"{name} {v:g}"]["speed"] for v in NEIGHBOURS[name]]) - speed

    return {
        "speed_m_per_s": speed,
        "speed_70_mm_m_per_s": longer["speed"],
        "tail_amplitude_m": best["tail_amplitude"],
        "tail_amplitude_70_mm_m": longer["tail_amplitude"],
        "shape_wavelength_m": wavelength,
        "shape_wavelength_70_mm_m": longer["shape_wavelength"],
        "wave_speed_m_per_s": wavelength * f,
        "speed_over_wave_speed": speed / (wavelength * f),
        "strouhal": best["strouhal"],
        "strouhal_70_mm": longer["strouhal"],
        "shape_tail_slope": best["shape_tail_slope"],
        "shape_tail_slope_70_mm": longer["shape_tail_slope"],
        "length_over_wavelength_70_mm": (SLIDER["body_length"] + 0.07) / longer["shape_wavelength"],
        **{f"gain_by_{name}_m_per_s": gain(name) for name in NEIGHBOURS},
        "best_phase": top.x,
        "best_phase_speed_m_per_s": top.y,
        "loss_by_negative_phase_m_per_s": at_phase[0.0] - at_phase[-0.15],
        "loss_by_half_phase_m_per_s": 0.5 * at_phase[0.2] - at_phase[0.5],
    }
