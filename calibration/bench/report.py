"""Bench identifications as statics.json, model.toml, a table and pictures."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from calibration.bench.ring_down import AIR_DRAG, RingFit
from calibration.bench.statics import DETERMINED, UNITS, BenchEstimate, ShapeFit
from calibration.bench.tables import Bench, Shapes
from slider_jax.io.figures import new_figure, save_figure
from slider_jax.io.files import versions
from slider_jax.io.toml import significant, toml_text

DEFINITIONS = {
    "interval": "95 %, from the scatter of the tables about the fit, or from the declared "
    "tip_noise where the scatter is not larger; lengths, masses and loads are taken as exact",
    "determined": f"half of the interval is below {DETERMINED:g} of the value",
    "offset": "the zero of a table's ruler, identified with the rest [m]",
    "K_Q": "its interval holds that of the EI identified from the same file's tip loads",
    "damping_time": "alpha of E = E_el (1 + alpha d/dt), from the whole ring-down of the full beam "
    f"with the air's drag, C_d = {AIR_DRAG[0]:g} +- {AIR_DRAG[1]:g} (one standard deviation)",
    "stiffness": "factor on EI_body and EI_tail that the ring-down's frequency asks for",
}
ADVICE = {
    "EI_body": "larger loads on the tail's end, or more of them",
    "EI_tail": 'a [[tip_load]] table with the tail alone held at its root, clamped = "joint"',
    "K_Q": "pressures that bend the tip by a tenth of the length or more",
    "damping_time": "a longer ring-down: until the swing has fallen to a third",
}


class Statics(NamedTuple):
    """What a bench file says."""

    bench: Bench
    shapes: ShapeFit | None
    ring: RingFit | None

    @property
    def parameters(self) -> dict[str, BenchEstimate]:
        found = dict(self.shapes.parameters) if self.shapes else {}
        return found | ({"damping_time": self.ring.damping_time} if self.ring else {})


def statics_record(found: Statics, source: dict[str, Any]) -> dict[str, Any]:
    """The content of statics.json; SI units."""
    shapes, ring = found.shapes, found.ring
    return {
        "parameters": {name: _told(name, x) for name, x in found.parameters.items()},
        "taken_as_given": {
            name: getattr(found.bench.robot, name) for name in UNITS if name not in found.parameters
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


def _told(name: str, x: BenchEstimate) -> dict[str, Any]:
    said = {"value": x.value, "low": x.low, "high": x.high, "unit": UNITS[name]}
    if x.determined:
        return said
    return said | {"value": None, "not_determined_by_these_data": True, "try": ADVICE[name]}


def _table(found: Statics, i: int) -> dict[str, Any]:
    table, fit = found.bench.shapes[i], found.shapes
    assert fit is not None
    apart = _measured(table) - fit.predicted[i]
    return {
        "file": table.name,
        "kind": table.kind,
        "rows": len(table.tip),
        "rms_residual_m": float(np.sqrt(np.mean(apart**2))),
        "largest_residual_m": float(np.abs(apart).max()),
        "noise_m": fit.noise[i],
        "noise_declared": table.noise is not None,
        "offset_m": fit.offsets[i],
    }


def _ring(found: Statics, ring: RingFit) -> dict[str, Any]:
    record = found.bench.ring_down
    assert record is not None
    apart = record.tip - ring.predicted
    return {
        "file": record.name,
        "samples": len(record.t),
        "frequency_Hz": ring.decay.frequency,
        "decay_rate_per_s": ring.decay.rate,
        "damping_time_by_decrement_s": ring.decay.damping_time,
        "stiffness": ring.stiffness._asdict(),
        "load_N": ring.load,
        "rms_residual_m": float(np.sqrt(np.mean(apart**2))),
        "noise_m": ring.noise,
        "mean_square_over_noise": ring.mean_square,
        "converged": ring.converged,
    }


def _measured(x: Shapes) -> np.ndarray:
    return x.tip if x.joint is None else np.concatenate([x.tip, x.joint])


def doubts(found: Statics) -> list[str]:
    """What does not fit, in sentences."""
    said = []
    shapes, ring = found.shapes, found.ring
    if shapes is not None:
        if not shapes.converged:
            said.append("The fit of the static shapes did not converge: check the tables.")
        if shapes.mean_square > 4.0:
            said.append(
                f"The static shapes lie {np.sqrt(shapes.mean_square):.1f} times further from the "
                "model than tip_noise says: see the pictures; the intervals are widened by that."
            )
    if ring is not None:
        if not ring.converged:
            said.append("The fit of the ring-down did not converge: see the picture.")
        if ring.mean_square > 4.0:
            said.append(
                f"The ring-down lies {np.sqrt(ring.mean_square):.1f} times further from the model "
                "than tip_noise says: see the picture; the interval is widened by that."
            )
        low, high = ring.stiffness.low, ring.stiffness.high
        if not low - 0.03 < 1.0 < high + 0.03:
            said.append(
                f"The ring-down's frequency asks for EI times {ring.stiffness.value:.3g} "
                f"({low:.3g} to {high:.3g}): stiffness, mass or lengths do not agree with it."
            )
    return said


def statics_table(found: Statics) -> str:
    """What was identified, a line a parameter."""
    lines = []
    for name, x in found.parameters.items():
        if x.determined:
            lines.append(f"{name:<14} {x.value:.4g}  ({x.low:.4g} to {x.high:.4g}) {UNITS[name]}")
        else:
            lines.append(f"{name:<14} not determined by these data; try {ADVICE[name]}")
    return "\n".join([*lines, *doubts(found)])


def statics_model_file(found: Statics) -> str:
    """What is determined, for `slider simulate --model`."""
    known = {n: x.value for n, x in found.parameters.items() if x.determined}
    tables = {
        table: {n: significant(x) for n, x in known.items() if (n == "K_Q") == own}
        for table, own in (("robot", False), ("parameters", True))
    }
    comment = f"Identified on the bench: {found.bench.table.name}."
    return toml_text({k: x for k, x in tables.items() if x}, comment, UNITS)


def pictures(found: Statics, folder: Path) -> None:
    """Measured and modelled tables, and what is left."""
    for i, one in enumerate(found.bench.shapes):
        assert found.shapes is not None
        _draw_shapes(one, found.shapes.predicted[i], folder / f"{Path(one.name).stem}.png")
    if found.ring is not None:
        _draw_ring(found, folder)


def _draw_shapes(one: Shapes, predicted: np.ndarray, path: Path) -> None:
    figure, (top, low) = new_figure(2, 1, figsize=(7.0, 6.0), sharex=True, height_ratios=[3, 2])
    if one.kind == "tip_load":
        load, name = one.force, "lateral force on the tail's end (N)"
    else:
        front = np.ptp(one.pressure[:, 0]) > 0.0
        load = one.pressure[:, 0 if front else 1] / 1e3
        name = f"pressure of the {'front' if front else 'rear'} chamber (kPa)"
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
