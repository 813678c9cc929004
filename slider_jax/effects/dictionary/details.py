"""Details of the terms: functions that a learned function gets if its terms are too coarse.

A term of `DICTIONARY` has three functions of a state, so it resolves a corner or a dip near the
state zero only roughly. `FINE_PARTS` contains the same functions with a quarter and a sixteenth of
the scale. These functions are constant beyond their scale, so they change the slope of the learned
function only near zero.

A term of the chambers is equal in all chambers. `REAR_PARTS` contains the same term in the last
chamber only, so that the chambers can differ. `REAR_READINGS` are the same for the pressure
sensors. They are terms of the dictionary, because most faults of a sensor concern one sensor, and
their tangents cost no simulation.
"""

from collections.abc import Iterator

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ActingPressure, Command, Effect, Flow, Instrument, parameter
from slider_jax.effects.check import defined_effects, is_complete
from slider_jax.effects.dictionary import (
    acting_pressure,
    bending_moment,
    command,
    flow,
    force_density,
    sensor,
    water_motion,
)
from slider_jax.effects.dictionary.acting_pressure import RearActingPressure
from slider_jax.effects.dictionary.command import RearCommand
from slider_jax.effects.dictionary.flow import RearFlow
from slider_jax.effects.dictionary.sensor import RearReading
from slider_jax.effects.functions import WHY_FACTOR, Powers

SCALES = (4.0, 16.0)
"""The scale of a term divided by the two scales of its fine part."""
ONE_CHAMBER = ("front_", "rear_")
"""Start of the names of terms that act in one chamber only."""


class FinePart(Powers):
    """The functions of a term with the scales of `SCALES`, each multiplied by a parameter.

    `a`, `b` and `c` belong to the first scale.
    """

    d: Scalar = parameter(0.0, -20.0, 20.0, "-", WHY_FACTOR)
    """Factor of the first function with the second scale."""
    e: Scalar = parameter(0.0, -20.0, 20.0, "-", WHY_FACTOR)
    """Factor of the second function with the second scale."""
    f: Scalar = parameter(0.0, -20.0, 20.0, "-", WHY_FACTOR)
    """Factor of the third function with the second scale."""

    def basis(self, z):
        """Returns the six functions at the state z."""
        of_term = super().basis  # type: ignore[misc]
        return [x for scale in SCALES for x in of_term(scale * z)]

    def total(self, basis):
        first, second, third, d, e, f = basis
        return super().total((first, second, third)) + self.d * d + self.e * e + self.f * f


REAR_PLACES: dict[type[Effect], type] = {
    Command: RearCommand,
    Flow: RearFlow,
    ActingPressure: RearActingPressure,
    Instrument: RearReading,
}


def _terms() -> Iterator[type[Effect]]:
    places = (command, flow, acting_pressure, bending_moment, force_density, water_motion, sensor)
    for place in places:
        yield from filter(is_complete, defined_effects(place))


def _part(kind: type[Effect], base: type, suffix: str, title: str) -> type[Effect]:
    text = {"__module__": __name__, "__doc__": f"A part of `{kind.name()}`: {title}."}
    name = f"{kind.__name__}{suffix}"
    return type(name, (base, kind), text | {"title": f"{kind.title}, {title}"})


def _has_rear_part(kind: type[Effect]) -> bool:
    """Returns whether the term acts in all chambers, and has no frequency."""
    of_chambers = kind.sensors == ("pressure",) or not issubclass(kind, Instrument)
    of_both = of_chambers and not kind.name().startswith(ONE_CHAMBER)
    return of_both and issubclass(kind, tuple(REAR_PLACES)) and "frequency" not in kind.shapes()


def _rear_parts(of_readings: bool) -> dict[str, type[Effect]]:
    found = {}
    for kind in filter(_has_rear_part, _terms()):
        base = next(x for place, x in REAR_PLACES.items() if issubclass(kind, place))
        title = "last chamber's sensor only" if of_readings else "difference of the last chamber"
        if (base is RearReading) == of_readings:
            found[kind.name()] = _part(kind, base, "OfRear", title)
    return found


def _has_fine_part(kind: type[Effect]) -> bool:
    return issubclass(kind, Powers) and "scale" in kind.shapes()


REAR_PARTS = _rear_parts(of_readings=False)
"""The part of the last chamber of each term that has one, by the name of the term."""
REAR_READINGS = {kind.name(): kind for kind in _rear_parts(of_readings=True).values()}
"""Terms of the last chamber's pressure sensor, by their own names."""
FINE_PARTS: dict[str, type[Effect]] = {
    kind.name(): _part(kind, FinePart, "Fine", "details near zero")
    for kind in (*_terms(), *REAR_PARTS.values(), *REAR_READINGS.values())
    if _has_fine_part(kind)
}
"""The fine part of each term that has one, by the name of the term or of its rear part."""
DETAILS: dict[str, type[Effect]] = {
    kind.name(): kind for kind in (*REAR_PARTS.values(), *FINE_PARTS.values())
}
"""All details by their own names."""
