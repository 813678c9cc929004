"""Fitted parameters as reports and model files show them."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from calibration.inference.gauss_newton import Fit
from calibration.inference.uncertainty import by_variation, confidence_interval, determined
from calibration.model.extended import Parameter
from slider_jax.io.toml import significant


def parameter_record(fit: Fit, entries: Sequence[Parameter], index: int) -> dict[str, Any]:
    """A fitted parameter as reports say it: no value where the data do not fix one, and of the
    interval what lies in the prior range."""
    p, (value, low, high) = entries[index], confidence_interval(fit, entries, index)
    said = {"value": value, "low": low, "high": high, "unit": p.prior.unit}
    if not determined(p, low, high):
        low, high = (float(np.clip(x, p.prior.low, p.prior.high)) for x in (low, high))
        said |= {"value": None, "low": low, "high": high, "not_determined_by_these_data": True}
    alone = by_variation(fit, index)
    return said | ({} if alone is None else {"by_variation_alone": alone})


def parameter_text(x: dict[str, Any]) -> str:
    """A parameter as `parameter_record`: value and interval, or that there is none."""
    within = f"({x['low']:.4g} to {x['high']:.4g}) {x['unit']}"
    value = "not determined by these data" if x["value"] is None else f"{x['value']:.4g}"
    said = f"{value}  {within}"
    return said + (f"; {widened(x)}" if "by_variation_alone" in x else "")


def widened(x: dict[str, Any]) -> str:
    """Why the interval is wider than the noise asks for."""
    return (
        f"by what varies of the forces alone {x['by_variation_alone']:.4g}, which is farther "
        "off than chance: the interval is widened for it"
    )


def model_tables(
    entries: Sequence[Parameter], theta: np.ndarray, effects: Sequence[str]
) -> dict[str, Any]:
    """Return the tables of a model file: the base parameters in `entries`, and `effects`."""
    values = {(p.effect, p.name): significant(x) for p, x in zip(entries, theta, strict=True)}
    parts = [
        {name: x for (effect, name), x in values.items() if effect == which}
        for which in ("", *effects)
    ]
    lacking = [{"name": name} | part for name, part in zip(effects, parts[1:], strict=True)]
    return {"parameters": parts[0]} | ({"effects": lacking} if lacking else {})
