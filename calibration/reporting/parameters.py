"""Converts fitted parameters to JSON records, to texts, and to tables of model files."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from calibration.inference.gauss_newton import Fit
from calibration.inference.uncertainty import (
    confidence_interval,
    correlation_factor,
    determined,
    value_by_variation,
)
from calibration.model.extended import Parameter
from slider_jax.io.toml import significant


def parameter_record(fit: Fit, entries: Sequence[Parameter], index: int) -> dict[str, Any]:
    """Returns the JSON record of the parameter `entries[index]`: value, 95 % interval and unit.

    If the data do not determine the parameter, its value is None and its interval is limited to
    the prior range. An entry that was not fitted is such a parameter; `fixed_at` is its value.
    """
    p = entries[index]
    if index not in fit.free:
        record = {"value": None, "low": p.prior.low, "high": p.prior.high, "unit": p.prior.unit}
        fixed_at = float(fit.theta[index])
        return record | {"not_determined_by_these_data": True, "fixed_at": fixed_at}
    value, low, high = confidence_interval(fit, entries, index)
    record = {"value": value, "low": low, "high": high, "unit": p.prior.unit}
    if not determined(p, low, high):
        low, high = (float(np.clip(x, p.prior.low, p.prior.high)) for x in (low, high))
        record |= {"value": None, "low": low, "high": high, "not_determined_by_these_data": True}
    alone, factor = value_by_variation(fit, index), correlation_factor(fit, index)
    record |= {} if alone is None else {"by_variation_alone": alone}
    return record | ({"widened_by_correlation": factor} if factor > 1.0 else {})


def parameter_text(x: dict[str, Any]) -> str:
    """Returns a `parameter_record` as text: value and 95 % interval."""
    within = f"({x['low']:.4g} to {x['high']:.4g}) {x['unit']}"
    value = undetermined(x) if x["value"] is None else f"{x['value']:.4g}"
    return f"{value}  {within}" + (f"; {widened(x)}" if "by_variation_alone" in x else "")


def undetermined(x: dict[str, Any]) -> str:
    """Returns the text in place of the value of an undetermined parameter."""
    fixed = f", fixed at {x['fixed_at']:.4g}" if "fixed_at" in x else ""
    return f"not determined by these data{fixed}"


def widened(x: dict[str, Any]) -> str:
    """Returns the reason for a widened interval."""
    return (
        f"without the mean forces, the fit gives {x['by_variation_alone']:.4g}; the difference "
        "from the value is significant, so the interval is widened"
    )


def model_tables(
    entries: Sequence[Parameter], theta: np.ndarray, effects: Sequence[str]
) -> dict[str, Any]:
    """Returns the tables of a model file: values of the base parameters and of the `effects`."""
    values = {(p.effect, p.name): significant(x) for p, x in zip(entries, theta, strict=True)}
    parts = [
        {name: x for (effect, name), x in values.items() if effect == which}
        for which in ("", *effects)
    ]
    lacking = [{"name": name} | part for name, part in zip(effects, parts[1:], strict=True)]
    return {"parameters": parts[0]} | ({"effects": lacking} if lacking else {})
