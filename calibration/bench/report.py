"""Writes the results of a bench as statics.json, model.toml, text and figures."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from calibration.bench.ring_down import AIR_DRAG, RingFit
from calibration.bench.statics import DETERMINED, UNITS, BenchEstimate, ShapeFit, given_values
from calibration.bench.tables import Bench, Shapes
from slider_jax.io.figures import new_figure, save_figure
from slider_jax.io.files import versions
from slider_jax.io.toml import significant, toml_text

DEFINITIONS = {
    "interval": "95 % interval, from the declared tip_noise or from the residual of the fit, "
    "whichever is larger. Lengths, masses and loads are assumed to be exact",
    "determined": f"half of the interval's width is less than {DETERMINED:g} times the value",
    "offset": "reading of the ruler at zero displacement, fitted for every table [m]",
    "K_Q": "the interval of K_Q includes the uncertainty of EI, which the tip loads identify",
    "damping_time": "alpha of the modulus E_el (1 + alpha d/dt), from the whole ring-down. The fit "
    f"includes drag in air with C_d = {AIR_DRAG[0]:g} +- {AIR_DRAG[1]:g} (one standard deviation)",
    "stiffness": "factor on EI_body and EI_tail with which the model has the measured frequency",
}
ADVICE = {
    "EI_body": "larger loads, or more loads, on the tail's end",
    "EI_tail": 'a [[tip_load]] table of the tail alone, clamped at its root: clamped = "joint"',
    "K_Q": "pressures that bend the tip by a tenth of the length or more",
    "damping_time": "a longer ring-down, until the amplitude is a third of its initial value",
}


class Statics(NamedTuple):
    """Measurements of a bench, the fit of the static shapes and the fit of the ring-down."""

    bench: Bench
    shapes: ShapeFit | None
    ring: RingFit | None

    @property
    def parameters(self) -> dict[str, BenchEstimate]:
        found = dict(self.shapes.parameters) if self.shapes else {}
        return found | ({"damping_time": self.ring.damping_time} if self.ring else {})


def statics_record(found: Statics, source: dict[str, Any]) -> dict[str, Any]:
    """Returns the content of statics.json, in SI units; `source` describes the input file."""
    shapes, ring = found.shapes, found.ring
    return {
        "parameters": {name: _estimate(name, x) for name, x in found.parameters.items()},
        "taken_as_given": {
            name: x
            for name, x in given_values(found.bench.robot).items()
            if name not in found.parameters
        },
        "correlations": shapes
        and {"order": list(shapes.parameters), "matrix": shapes.correlations},
        "tables": [_table(found, i) for i in range(len(found.bench.shapes))],
        "ring_down": ring and _ring(found, ring),
        "definitions": DEFINITIONS,
        "input": source,
        "settings": found.bench.table.model_dump(),
        "versions": versions(),
    }


def _estimate(name: str, x: BenchEstimate) -> dict[str, Any]:
    record = {"value": x.value, "low": x.low, "high": x.high, "unit": UNITS[name]}
    if x.determined:
        return record
    return record | {"value": None, "not_determined_by_these_data": True, "try": ADVICE[name]}


def _table(found: Statics, i: int) -> dict[str, Any]:
    table, fit = found.bench.shapes[i], found.shapes
    assert fit is not None
    residual = table.measured - fit.predicted[i]
    return {
        "file": table.name,
        "kind": table.kind,
        "rows": len(table.tip),
        "rms_residual_m": float(np.sqrt(np.mean(residual**2))),
        "largest_residual_m": float(np.abs(residual).max()),
        "noise_m": fit.noise[i],
        "noise_declared": table.noise is not None,
        "offset_m": fit.offsets[i],
    }


def _ring(found: Statics, ring: RingFit) -> dict[str, Any]:
    record = found.bench.ring_down
    assert record is not None
    residual = record.tip - ring.predicted
    return {
        "file": record.name,
        "samples": len(record.t),
        "frequency_Hz": ring.decay.frequency,
        "decay_rate_per_s": ring.decay.rate,
        "damping_time_by_decrement_s": ring.decay.damping_time,
        "stiffness": ring.stiffness._asdict(),
        "load_N": ring.load,
        "rms_residual_m": float(np.sqrt(np.mean(residual**2))),
        "noise_m": ring.noise,
        "mean_square_over_noise": ring.mean_square,
        "converged": ring.converged,
    }


def _warnings(found: Statics) -> list[str]:
    """Returns warnings: fits that did not converge, large residuals and a wrong frequency."""
    text = []
    shapes, ring = found.shapes, found.ring
    if shapes is not None:
        if not shapes.converged:
            text.append("The fit of the static shapes did not converge: check the tables.")
        if shapes.mean_square > 4.0:
            text.append(
                f"The residual of the static shapes is {np.sqrt(shapes.mean_square):.1f} times "
                "tip_noise. The intervals were widened by this factor: see the figures."
            )
    if ring is not None:
        if not ring.converged:
            text.append("The fit of the ring-down did not converge: see the figure.")
        if ring.mean_square > 4.0:
            text.append(
                f"The residual of the ring-down is {np.sqrt(ring.mean_square):.1f} times "
                "tip_noise. The interval was widened by this factor: see the figure."
            )
        low, high = ring.stiffness.low, ring.stiffness.high
        if not low - 0.03 < 1.0 < high + 0.03:
            text.append(
                f"The ring-down's frequency requires {ring.stiffness.value:.3g} times the given EI "
                f"({low:.3g} to {high:.3g}): check the given stiffness, mass and lengths."
            )
    return text


def statics_table(found: Statics) -> str:
    """Returns the identified parameters as text, one per line, and warnings."""
    lines = []
    for name, x in found.parameters.items():
        if x.determined:
            lines.append(f"{name:<14} {x.value:.4g}  ({x.low:.4g} to {x.high:.4g}) {UNITS[name]}")
        else:
            lines.append(f"{name:<14} not determined by these data; try {ADVICE[name]}")
    return "\n".join([*lines, *_warnings(found)])


def statics_model_file(found: Statics) -> str:
    """Returns the determined parameters as a model file for `slider simulate --model`."""
    known = {n: x.value for n, x in found.parameters.items() if x.determined}
    tables = {
        table: {n: significant(x) for n, x in known.items() if (n == "K_Q") == own}
        for table, own in (("robot", False), ("parameters", True))
    }
    comment = f"Identified on the bench: {found.bench.table.name}."
    return toml_text({k: x for k, x in tables.items() if x}, comment, UNITS)


def draw_statics(found: Statics, folder: Path) -> None:
    """Writes a figure of every table to `folder`: measurement, model and residual."""
    for i, one in enumerate(found.bench.shapes):
        assert found.shapes is not None
        chambers = [x.name for x in found.bench.table.chambers]
        path = folder / f"{Path(one.name).stem}.png"
        _draw_shapes(one, chambers, found.shapes.predicted[i], path)
    if found.ring is not None:
        _draw_ring(found, folder)


def _draw_shapes(one: Shapes, chambers: Sequence[str], predicted: np.ndarray, path: Path) -> None:
    figure, (top, low) = new_figure(2, 1, figsize=(7.0, 6.0), sharex=True, height_ratios=[3, 2])
    if one.kind == "tip_load":
        load, name = one.force, "lateral force on the tail's end (N)"
    else:
        moved = int(np.argmax(np.ptp(one.pressure, axis=0) > 0.0))
        load = one.pressure[:, moved] / 1e3
        name = f"pressure of the {chambers[moved]} chamber (kPa)"
    count = len(one.tip)
    parts = [("tip", one.tip, predicted[:count], "tab:blue")]
    if one.joint is not None:
        parts.append(("joint", one.joint, predicted[count:], "tab:green"))
    for label, measured, modelled, colour in parts:
        top.plot(load, 1e3 * modelled, "-", color=colour, label=f"{label}, model")
        top.plot(
            load, 1e3 * measured, "o", ms=4, color="black", mfc=colour, label=f"{label}, measured"
        )
        low.plot(load, 1e3 * (measured - modelled), "o-", color=colour, label=label)
    low.axhline(0.0, color="0.4", lw=0.7)
    top.set_ylabel("lateral displacement (mm)")
    low.set_ylabel("measured - model (mm)")
    low.set_xlabel(name)
    top.legend(fontsize=8)
    top.set_title(one.name, fontsize=10)
    save_figure(figure, path)


def _draw_ring(found: Statics, folder: Path) -> None:
    record, ring = found.bench.ring_down, found.ring
    assert record is not None and ring is not None
    figure, (top, low) = new_figure(2, 1, figsize=(9.0, 6.0), sharex=True, height_ratios=[3, 2])
    top.plot(record.t, 1e3 * record.tip, ".", ms=2.5, color="black", label="measured")
    top.plot(record.t, 1e3 * ring.predicted, color="tab:blue", lw=0.9, label="model")
    low.plot(record.t, 1e3 * (record.tip - ring.predicted), ".", ms=2.5, color="tab:blue")
    low.axhspan(-2e3 * ring.noise, 2e3 * ring.noise, color="0.85")
    low.axhline(0.0, color="0.4", lw=0.7)
    top.set_ylabel("tip (mm)")
    low.set_ylabel("measured - model (mm)")
    low.set_xlabel("time since the release (s); grey: two standard deviations of the noise")
    top.legend(fontsize=8, loc="upper right")
    top.set_title(
        f"{record.name}: {ring.decay.frequency:.3g} Hz, alpha = "
        f"{1e3 * ring.damping_time.value:.3g} ms",
        fontsize=10,
    )
    save_figure(figure, folder / f"{Path(record.name).stem}.png")
