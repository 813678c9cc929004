"""Writes an animal's axial force balance as report.json, as text and as report.html."""

from typing import Any

import numpy as np

from calibration.lamprey.axial_balance import (
    ASPECT_RANGE,
    BASE_EFFECTS,
    C_D_RANGE,
    CANDIDATES,
    EFFECTS,
    LENGTH_ERROR,
    M_A_RANGE,
    SMOOTHING_FACTORS,
    TAIL_RANGE,
    central_interval,
)
from calibration.lamprey.balance import (
    WIDTH_COLUMN,
    WIDTH_OVER_HALF_WIDTH,
    BalanceAnalysis,
    balance_verdict,
    frontal_coefficient,
    imbalance_errors,
    midline_misfit,
    skin_friction,
    small_amplitude_thrust,
    within_stride,
)
from calibration.lamprey.figures import body_figure, imbalance_figure, strides_figure
from calibration.reporting.html import embedded_png, render_page
from slider_jax.io.files import versions

NEXT_ANIMAL_EXPERIMENT = (
    "Measure a gliding animal (straight, no stroke) at two speeds, to discriminate between "
    "friction and form drag. Only a swimming animal can thin its boundary layer."
)


def interval_record(value: float, low: float, high: float, unit: str) -> dict[str, Any]:
    """Returns a value with interval and unit, as a record of report.json."""
    return {"value": value, "low": low, "high": high, "unit": unit}


def animal_record(
    x: BalanceAnalysis, seconds: float, sources: list[dict[str, Any]]
) -> dict[str, Any]:
    """Returns the content of report.json; `sources` has one record for each input file."""
    verdict, candidates = balance_verdict(x)
    closer = CANDIDATES[0]
    stride_errors = imbalance_errors(x, closer) | {"closed_by": closer}
    imbalance = x.samples.imbalance
    g = x.gait
    mean = {n: float(x.forces.unit[n].mean()) for n in EFFECTS}
    return {
        "verdict": verdict,
        "said": animal_sentence(x),
        "imbalance": {
            "paper_coefficients": interval_record(
                float(x.imbalance.mean()), *x.by_source["strides"], "N"
            ),
            "all_ranges": interval_record(
                float(np.median(imbalance)), *central_interval(imbalance), "N"
            ),
            "intervals_by_source": {n: list(v) for n, v in x.by_source.items()},
            "other_smoothing": {n: value for n, (_, value) in x.other_smoothings.items()},
            "by_stride": x.imbalance,
        },
        "forces": {
            "reactive_force": x.m_a * mean[BASE_EFFECTS[0]],
            "normal_drag": x.C_d * mean[BASE_EFFECTS[1]],
            "momentum_gained": float(x.forces.gain.mean()),
            "reactive_force_at_m_a_1": mean[BASE_EFFECTS[0]],
            "lighthill_small_amplitude": small_amplitude_thrust(x),
            "unit": "N",
        },
        "effects": closing_effects(x, candidates),
        "candidates": closing_candidates(x),
        "parameters": {"C_d": x.C_d, "m_a": x.m_a},
        "errors": {"mean_axial_force_of_a_stride": stride_errors},
        "skin": skin_friction(x),
        "head": interval_record(*frontal_coefficient(x), "-"),
        "within_stride": within_stride(x),
        "gait": {
            "speed_m_per_s": g.speed, "frequency_Hz": g.frequency, "strides": x.strides.number,
            "tail_amplitude_m": g.tail_amplitude, "wavelength_m": g.wavelength,
            "wave_speed_m_per_s": g.wave_speed, "travelling_index": g.travelling_index,
            "strouhal": g.strouhal, "reynolds": g.reynolds, "length_m": x.motion.length,
            "mass_kg": x.prescribed.body.mass,
        },
        "settings": _settings(x),
        "audit": midline_quality(x),
        "next_experiment": NEXT_ANIMAL_EXPERIMENT if verdict == "class" else None,
        "seconds": seconds,
        "input": sources,
        "versions": versions(),
    }  # fmt: skip


def closing_effects(x: BalanceAnalysis, candidates: list[str]) -> list[dict[str, Any]]:
    """Returns a list with one record: the most probable effect and its equivalents. May be []."""
    if not candidates:
        return []
    first, *others = candidates
    return [
        {
            "name": first,
            "title": EFFECTS[first].title,
            "class": others,
            "parameters": _closing(x, first),
            "where": "mean axial force over whole strides",
        }
    ]


def _closing(x: BalanceAnalysis, name: str) -> dict[str, Any]:
    """Returns {parameter: record of the value that closes the balance} for the effect `name`."""
    ((parameter, prior),) = EFFECTS[name].priors().items()
    values = x.samples.closing(name)
    record = interval_record(float(np.median(values)), *central_interval(values), prior.unit)
    return {parameter: record}


def closing_candidates(x: BalanceAnalysis) -> list[dict[str, Any]]:
    """Returns a record for each effect, with the coefficient that closes the balance."""
    share = x.possible
    rows = []
    for name in sorted(EFFECTS, key=lambda n: -share[n]):
        ((parameter, needs),) = _closing(x, name).items()
        prior = EFFECTS[name].priors()[parameter]
        rows.append(
            {
                "name": name, "title": EFFECTS[name].title, "possible": share[name],
                "parameter": parameter, "needs": needs, "prior": [prior.low, prior.high],
            }
        )  # fmt: skip
    return rows


def _settings(x: BalanceAnalysis) -> dict[str, Any]:
    """Returns the settings of the smoothing and the assumed values and ranges."""
    return {
        "smoothing": {"wavelength_L": x.smoothing.wavelength, "cutoff_Hz": x.smoothing.cutoff},
        "width": f"{WIDTH_COLUMN} times {WIDTH_OVER_HALF_WIDTH:g}, as for a half width (assumed)",
        "aspect": x.shape.aspect,
        "tail_depth_L": x.shape.tail_depth,
        "density_kg_per_m3": x.shape.density,
        "ranges": {
            "aspect": ASPECT_RANGE, "tail_depth_L": TAIL_RANGE, "C_d": C_D_RANGE,
            "m_a": M_A_RANGE, "length_relative_sd": LENGTH_ERROR,
            "smoothing_factors": SMOOTHING_FACTORS,
        },
        "draws": len(x.samples.C_d),
    }  # fmt: skip


def midline_quality(x: BalanceAnalysis) -> list[str]:
    """Returns sentences on the quality of the midlines."""
    lengths = 1e3 * x.midlines.lengths
    return [
        f"The analysis omits {x.midlines.incomplete_frames} incomplete frames at the ends.",
        f"The traced length is {lengths.min():.0f} to {lengths.max():.0f} mm, because the tail's "
        "end was not always visible. The analysis measures distances from the head, and keeps the "
        "body length constant.",
        f"The smoothed body is {1e3 * midline_misfit(x):.2f} mm (rms) from the measured points.",
    ]


def animal_sentence(x: BalanceAnalysis) -> str:
    """Returns the verdict in up to three sentences."""
    verdict, candidates = balance_verdict(x)
    low, high = (1e3 * v for v in central_interval(x.samples.imbalance))
    first = 1e3 * x.imbalance.mean()
    sentence = (
        f"With the paper's coefficients (C_d {x.C_d:g}, m_a {x.m_a:g}), the model's mean forward "
        f"force exceeds the animal's gain of momentum per unit time by {first:.2f} mN (95 % "
        f"interval with all uncertainties: {low:.2f} to {high:.2f} mN)."
    )
    if verdict == "nothing_missing":
        return sentence + " The interval includes zero, so the data show no missing effect."
    if verdict == "unexplained":
        return sentence + " No candidate closes the balance within its prior range."
    name = candidates[0]
    ((parameter, needs),) = _closing(x, name).items()
    sentence += (
        f" {EFFECTS[name].title} ({name}) closes the balance with {parameter} = "
        f"{needs['value']:.3g} ({needs['low']:.2g} to {needs['high']:.2g})."
    )
    if verdict == "identified":
        return sentence
    others = ", ".join(candidates[1:])
    return f"{sentence} One mean force cannot discriminate this effect from {others}."


def balance_table(x: BalanceAnalysis) -> str:
    """Returns the axial force balance as a text table."""
    mean = {n: 1e3 * x.forces.unit[n].mean() for n in BASE_EFFECTS}
    low, high = (1e3 * v for v in central_interval(x.samples.imbalance))
    rows = [
        ("reactive force", x.m_a * mean[BASE_EFFECTS[0]]),
        ("normal drag", x.C_d * mean[BASE_EFFECTS[1]]),
        ("momentum gained per time", 1e3 * x.forces.gain.mean()),
        ("imbalance", 1e3 * x.imbalance.mean()),
    ]
    lines = [f"{name:<24}{value:8.2f} mN" for name, value in rows]
    lines.append(f"{'95 % interval':<24}{low:8.2f} to {high:.2f} mN")
    for row in closing_candidates(x):
        n = row["needs"]
        lines.append(
            f"{row['name']:<24}{row['parameter']} = {n['value']:.3g} ({n['low']:.2g} to "
            f"{n['high']:.2g} {n['unit']}); in the prior range: {row['possible']:.0%} of samples"
        )
    return "\n".join(lines)


def animal_page(x: BalanceAnalysis, record: dict[str, Any]) -> str:
    """Returns report.html; `record` is the content of report.json."""
    return render_page(
        "lamprey.html",
        title="Axial force balance of a swimming lamprey",
        record=record,
        body_png=embedded_png(body_figure(x)),
        strides_png=embedded_png(strides_figure(x)),
        imbalance_png=embedded_png(imbalance_figure(x)),
        candidates=[
            [
                row["name"], row["parameter"], f"{row['needs']['value']:.3g}",
                f"{row['needs']['low']:.2g} to {row['needs']['high']:.2g}", row["needs"]["unit"],
                f"{row['possible']:.0%} of samples",
            ]
            for row in record["candidates"]
        ],
        assumptions=_assumptions(x),
    )  # fmt: skip


def _assumptions(x: BalanceAnalysis) -> list[list[str]]:
    along, in_time, (fine, coarse) = x.smoothing.wavelength, x.smoothing.cutoff, SMOOTHING_FACTORS
    ranges: list[tuple[str, float, tuple[float, float]]] = [
        ("depth divided by width", x.shape.aspect, ASPECT_RANGE),
        ("depth at the tail's end (body lengths)", x.shape.tail_depth, TAIL_RANGE),
        ("C_d", x.C_d, C_D_RANGE),
        ("m_a", x.m_a, M_A_RANGE),
        ("smoothing wavelength (body lengths)", along, (along * fine, along * coarse)),
        ("cutoff frequency in time (Hz)", in_time, (in_time / coarse, in_time / fine)),
    ]
    width = f"{WIDTH_OVER_HALF_WIDTH:g} x {WIDTH_COLUMN}"
    return [
        *([name, f"{x:.3g}", f"{low:.3g} to {high:.3g}"] for name, x, (low, high) in ranges),
        ["width", width, f"{WIDTH_COLUMN} is assumed to be a half width"],
    ]
