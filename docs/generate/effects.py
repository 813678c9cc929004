"""Generates the page of the effects library from the classes of the effects."""

import inspect

from slider_jax.cli.effects import place_of
from slider_jax.effects import Prior
from slider_jax.effects.check import PLACES
from slider_jax.effects.library import LIBRARY

PAGE = "reference/effects.md"


def _parameter(name: str, prior: Prior) -> str:
    unit = "" if prior.unit == "-" else prior.unit
    return f"| `{name}` | {prior.null:g} | {prior.low:g} to {prior.high:g} | {unit} | {prior.why} |"


def _shape(name: str, shape: Prior) -> str:
    unit = "" if shape.unit == "-" else shape.unit
    return (
        f"| `{name}` | {shape.null:.4g} | {shape.low:g} to {shape.high:g} | {unit} | {shape.why} |"
    )


def _shapes(shapes: dict[str, Prior]) -> list[str]:
    if not shapes:
        return []
    return [
        *(
            "| shape parameter | default value | prior range | unit | reason |",
            "|---|---|---|---|---|",
        ),
        *(_shape(name, shape) for name, shape in shapes.items()),
        "",
    ]


def _effect(name: str) -> list[str]:
    kind = LIBRARY[name]
    segments = f" Acts on: {', '.join(kind.segments)}." if kind.segments else ""
    sensors = f"Sensors: {', '.join(kind.sensors)}."
    return [
        *(f"### `{name}`", "", f"**{kind.title}**. {sensors}{segments}", ""),
        *("```text", inspect.getdoc(kind) or "", "```", ""),
        *("| parameter | null value | prior range | unit | reason |", "|---|---|---|---|---|"),
        *(_parameter(parameter, prior) for parameter, prior in kind.priors().items()),
        "",
        *_shapes(kind.shapes()),
    ]


def pages() -> dict[str, str]:
    """Returns a dictionary from the path of the effects page to its text."""
    lines = [
        "# Effects library",
        "",
        f"The library has {len(LIBRARY)} effects. `slider effects` lists all effects.",
        "`slider effects NAME --out DIR` draws the change that one effect causes on each sensor. A",
        "table in an experiment or model file adds an effect to the model:",
        "",
        "```toml",
        "[[effects]]",
        'name = "valve_delay"',
        "delay = 0.02",
        "```",
        "",
        "If a parameter has its null value, the effect vanishes. Calibration searches a parameter",
        "within its prior range. A shape parameter, such as a time constant, has no influence",
        "while the other parameters of the effect have their null values. `slider close-loop` fits",
        "the shape parameters of the effects that it adds.",
        "[Adding an effect](../how-to/adding_an_effect.md) explains how to write a new effect.",
        "",
    ]
    for place in PLACES:
        names = [name for name, kind in LIBRARY.items() if place_of(kind) is place]
        if names:
            lines += [f"## {place.__name__}", "", inspect.getdoc(place) or "", ""]
            lines += [line for name in names for line in _effect(name)]
    return {PAGE: "\n".join(lines)}
