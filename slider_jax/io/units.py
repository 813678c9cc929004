"""Numbers with a unit and a plausible range, and the error for a value outside the range."""

import math
from dataclasses import dataclass
from typing import Any

from pydantic_core import PydanticCustomError, core_schema

_ADVICE = {
    "m": "lengths are in metres",
    "kg/m": "mass per length is in kilograms per metre",
    "kg/m^3": "density is in kilograms per cubic metre",
    "N": "forces are in newtons",
    "N m^2": "bending stiffness is in newton square metres",
    "s": "times are in seconds",
    "Hz": "frequencies are in hertz",
    "Pa": "pressures are in pascal, not kPa or psi",
    "m^3": "moment per pressure is in cubic metres",
    "m/s": "speeds are in metres per second",
    "rad": "angles are in radians",
    "fraction of a period": "not in degrees or radians",
}


@dataclass(frozen=True)
class Quantity:
    """A number in [low, high]: `Annotated[float, Quantity(low, high, unit)]` in a pydantic model.

    With `or_zero`, exactly 0 is also allowed. The range detects a wrong unit (millimetres, grams,
    kPa): the range contains all plausible values, but few values with an error by a factor of 1000.
    """

    low: float
    high: float
    unit: str = ""
    or_zero: bool = False

    @property
    def allowed(self) -> str:
        """The range and unit as text."""
        zero = "0, or " if self.or_zero else ""
        return f"{zero}{self.low:g} to {self.high:g} {self.unit}".rstrip()

    @property
    def advice(self) -> str:
        """A sentence that names the unit."""
        return _ADVICE.get(self.unit, "")

    def check(self, value: float) -> float:
        """Returns `value` if it is allowed; otherwise raises an error that names the range."""
        if self.or_zero and value == 0.0:
            return value
        if math.isfinite(value) and self.low <= value <= self.high:
            return value
        advice = f"; {self.advice}" if self.advice else ""
        raise PydanticCustomError(
            "quantity",
            "given {given}; allowed {allowed}{advice}",
            {"given": repr(value), "allowed": self.allowed, "advice": advice},
        )

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> core_schema.CoreSchema:
        number = core_schema.float_schema(strict=True)
        return core_schema.no_info_after_validator_function(self.check, number)
