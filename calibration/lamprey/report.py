"""The weighed animal as report.json, in sentences, and as report.html."""

from typing import Any

import numpy as np

from calibration.lamprey.axial_balance import (
    ASPECT_RANGE,
    BASE,
    C_D_RANGE,
    CANDIDATES,
    COARSER,
    EFFECTS,
    LENGTH_ERROR,
    M_A_RANGE,
    TAIL_RANGE,
    central_interval,
)
from calibration.lamprey.balance import (
    FULL_OVER_GIVEN,
    WIDTH_COLUMN,
    Weighed,
    balance_verdict,
    errors,
    frontal_coefficient,
    skin,
    small_amplitude_thrust,
    within_stride,
)
from calibration.lamprey.figures import body_figure, imbalance_figure, strides_figure
from calibration.reporting.html import embedded_png, render_page
from slider_jax.io.files import versions

NEXT = (
    "A gliding animal (straight, no stroke) sees friction and form drag alone; two speeds of it "
    "separate them. The thinning of the boundary layer then is what swimming adds."
)


def interval_record(value: float, low: float, high: float, unit: str) -> dict[str, Any]:
    """A number with its interval, as reports say it."""
    return {"value": value, "low": low, "high": high, "unit": unit}


def animal_record(x: Weighed, seconds: float, sources: list[dict[str, Any]]) -> dict[str, Any]:
    """The content of report.json; `sources` names the inputs."""
    verdict, able = balance_verdict(x)
    closer = CANDIDATES[0]
    draws = x.draws.imbalance
    g = x.gait
    mean = {n: float(x.ledger.unit[n].mean()) for n in EFFECTS}
    return {
        "verdict": verdict,
        "said": animal_sentence(x),
        "imbalance": {
            "paper_coefficients": interval_record(
                float(x.imbalance.mean()), *x.by_source["strides"], "N"
            ),
            "all_ranges": interval_record(float(np.median(draws)), *central_interval(draws), "N"),
            "intervals_by_source": {n: list(v) for n, v in x.by_source.items()},
            "other_smoothing": {n: value for n, (_, value) in x.smoothed.items()},
            "by_stride": x.imbalance,
        },
        "forces": {
            "reactive_force": x.m_a * mean[BASE[0]],
            "normal_drag": x.C_d * mean[BASE[1]],
            "momentum_gained": float(x.ledger.gain.mean()),
            "reactive_force_at_m_a_1": mean[BASE[0]],
            "lighthill_small_amplitude": small_amplitude_thrust(x),
            "unit": "N",
        },
        "effects": closing_effects(x, able),
        "candidates": closing_candidates(x),
        "parameters": {"C_d": x.C_d, "m_a": x.m_a},
        "errors": {"mean_axial_force_of_a_stride": errors(x, closer) | {"closed_by": closer}},
        "skin": skin(x),
        "head": interval_record(*frontal_coefficient(x), "-"),
        "within_stride": within_stride(x),
        "gait": {
            "speed_m_per_s": g.speed, "frequency_Hz": g.frequency, "strides": x.strides.number,
            "tail_amplitude_m": g.tail_amplitude, "wavelength_m": g.wavelength,
            "wave_speed_m_per_s": g.wave_speed, "travelling_index": g.travelling_index,
            "strouhal": g.strouhal, "reynolds": g.reynolds, "length_m": x.motion.length,
            "mass_kg": x.held.body.mass,
        },
        "settings": settings(x),
        "audit": midline_quality(x),
        "next_experiment": NEXT if verdict == "class" else None,
        "seconds": seconds,
        "input": sources,
        "versions": versions(),
    }  # fmt: skip


def closing_effects(x: Weighed, able: list[str]) -> list[dict[str, Any]]:
    """The effect that is named first, and those it cannot be told from."""
    if not able:
        return []
    first, *others = able
    return [
        {
            "name": first,
            "title": EFFECTS[first].title,
            "class": others,
            "parameters": {_parameter(first): _closing(x, first)},
            "where": "mean axial force over whole strides",
        }
    ]


def _parameter(name: str) -> str:
    (parameter,) = EFFECTS[name].priors()
    return parameter


def _closing(x: Weighed, name: str) -> dict[str, Any]:
    (prior,) = EFFECTS[name].priors().values()
    values = x.draws.closing(name)
    return interval_record(float(np.median(values)), *central_interval(values), prior.unit)


def closing_candidates(x: Weighed) -> list[dict[str, Any]]:
    """What every effect alone would need to close the balance."""
    share = x.possible
    rows = []
    for name in sorted(EFFECTS, key=lambda n: -share[n]):
        (prior,) = EFFECTS[name].priors().values()
        needs = {"parameter": _parameter(name), "needs": _closing(x, name)}
        rows.append(
            {"name": name, "title": EFFECTS[name].title, "possible": share[name]}
            | needs
            | {"prior": [prior.low, prior.high]}
        )
    return rows


def settings(x: Weighed) -> dict[str, Any]:
    """What was chosen and assumed."""
    return {
        "smoothing": {"wavelength_L": x.smoothing.wavelength, "cutoff_Hz": x.smoothing.cutoff},
        "width": f"{WIDTH_COLUMN} times {FULL_OVER_GIVEN:g}: taken for a half width",
        "aspect": x.shape.aspect,
        "tail_depth_L": x.shape.tail_depth,
        "density_kg_per_m3": x.shape.density,
        "ranges": {
            "aspect": ASPECT_RANGE, "tail_depth_L": TAIL_RANGE, "C_d": C_D_RANGE,
            "m_a": M_A_RANGE, "length_relative_sd": LENGTH_ERROR, "smoothing_factors": COARSER,
        },
        "draws": len(x.draws.C_d),
    }  # fmt: skip


def midline_quality(x: Weighed) -> list[str]:
    """What the midlines themselves say of their quality."""
    lengths, w = 1e3 * x.midlines.lengths, within_stride(x)
    return [
        f"{x.midlines.left_out} frames at the ends are blank and left out.",
        f"The traced length runs from {lengths.min():.0f} to {lengths.max():.0f} mm: where the "
        "tail was seen to end. Distances are taken from the head, and the length is kept.",
        f"The smoothed body is {1e3 * w['misfit_of_midlines_m']:.2f} mm rms off the points.",
    ]


def animal_sentence(x: Weighed) -> str:
    """The verdict in a sentence or three."""
    verdict, able = balance_verdict(x)
    low, high = (1e3 * v for v in central_interval(x.draws.imbalance))
    first = 1e3 * x.imbalance.mean()
    said = (
        f"With the paper's coefficients (C_d {x.C_d:g}, m_a {x.m_a:g}) the model pushes this "
        f"animal forward by {first:.2f} mN more than its momentum gains"
        f"; with all that one animal leaves open, {low:.2f} to {high:.2f} mN (95 %)."
    )
    if verdict == "nothing_missing":
        return said + " That holds zero: nothing is missing at this precision."
    if verdict == "unexplained":
        return said + " None of the candidates closes it with a value that is believed."
    name, needs = able[0], _closing(x, able[0])
    closes = (
        f" {EFFECTS[name].title} ({name}) closes it with {_parameter(name)} = "
        f"{needs['value']:.3g} ({needs['low']:.2g} to {needs['high']:.2g})"
    )
    if verdict == "identified":
        return said + closes + "."
    return said + closes + f"; one mean force cannot tell it from {', '.join(able[1:])}."


def balance_table(x: Weighed) -> str:
    """The balance in lines, for the terminal."""
    mean = {n: 1e3 * x.ledger.unit[n].mean() for n in BASE}
    low, high = (1e3 * v for v in central_interval(x.draws.imbalance))
    rows = [
        ("reactive force", x.m_a * mean[BASE[0]]),
        ("normal drag", x.C_d * mean[BASE[1]]),
        ("momentum gained", 1e3 * x.ledger.gain.mean()),
        ("imbalance", 1e3 * x.imbalance.mean()),
    ]
    lines = [f"{name:<24}{value:8.2f} mN" for name, value in rows]
    lines.append(f"{'all ranges, 95 %':<24}{low:8.2f} to {high:.2f} mN")
    for row in closing_candidates(x):
        n = row["needs"]
        lines.append(
            f"{row['name']:<24}{row['parameter']} = {n['value']:.3g} ({n['low']:.2g} to "
            f"{n['high']:.2g} {n['unit']}); believable in {row['possible']:.0%}"
        )
    return "\n".join(lines)


def animal_page(x: Weighed, record: dict[str, Any]) -> str:
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


def _assumptions(x: Weighed) -> list[list[str]]:
    along, in_time, (fine, coarse) = x.smoothing.wavelength, x.smoothing.cutoff, COARSER
    ranges: list[tuple[str, float, tuple[float, float]]] = [
        ("depth over width", x.shape.aspect, ASPECT_RANGE),
        ("depth at the tail's end (lengths)", x.shape.tail_depth, TAIL_RANGE),
        ("C_d", x.C_d, C_D_RANGE),
        ("m_a", x.m_a, M_A_RANGE),
        ("smoothing along the body (lengths)", along, (along * fine, along * coarse)),
        ("smoothing in time (Hz)", in_time, (in_time / coarse, in_time / fine)),
    ]
    rows = [
        [name, f"{value:.3g}", f"{low:.3g} to {high:.3g}"] for name, value, (low, high) in ranges
    ]
    rows.append(["width", f"{FULL_OVER_GIVEN:g} x {WIDTH_COLUMN}", "taken for a half width"])
    return rows
