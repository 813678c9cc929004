"""Quantities and base class of the tables of an experiment file."""

import re
from pathlib import PurePath
from typing import Annotated, Any, NoReturn

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict
from pydantic_core import PydanticCustomError

from slider_jax.io.toml import TAG
from slider_jax.io.units import Quantity

FROM_LIST = BeforeValidator(lambda x: tuple(x) if isinstance(x, list) else x)
Length = Annotated[float, Quantity(0.0, 3.0, "m")]
LinearDensity = Annotated[float, Quantity(0.01, 20.0, "kg/m")]
TorsionalStiffness = Annotated[float, Quantity(1e-6, 100.0, "N m^2")]
PolarInertia = Annotated[float, Quantity(1e-9, 1.0, "kg m")]
BendingStiffness = Annotated[float, Quantity(1e-6, 100.0, "N m^2")]
Stiffness = Annotated[float, Quantity(1.0, 1e7, "N")]
DampingTime = Annotated[float, Quantity(0.0, 0.1, "s")]
Width = Annotated[float, Quantity(0.0, 0.5, "m")]
Height = Annotated[float, Quantity(0.002, 0.5, "m")]
Density = Annotated[float, Quantity(50.0, 20000.0, "kg/m^3")]
WaterDensity = Annotated[float, Quantity(900.0, 1300.0, "kg/m^3")]
Span = Annotated[tuple[Length, Length], FROM_LIST]
Speed = Annotated[float, Quantity(-3.0, 3.0, "m/s")]
Position = Annotated[float, Quantity(-10.0, 10.0, "m")]
Force = Annotated[float, Quantity(0.0, 10.0, "N")]
Share = Annotated[float, Quantity(0.0, 0.5)]


def _plain_name(name: str, ending: str = ".csv") -> str:
    """Returns `name`, or raises an error if `name` is not a file name without folder."""
    parts = PurePath(name.replace("\\", "/")).parts
    if len(parts) != 1 or parts[0] in ("..", ".") or not name.endswith(ending):
        raise PydanticCustomError(
            "file_name",
            "given {given}; allowed a plain file name without folder, ending in {ending}",
            {"given": repr(name), "ending": ending},
        )
    return name


def _identifier(name: str) -> str:
    """Returns `name`, or raises an error if `name` cannot be a part of a column's name."""
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise PydanticCustomError(
            "name",
            "given {given}; allowed lower-case letters, digits and _, with a letter first",
            {"given": repr(name)},
        )
    return name


FileName = Annotated[str, AfterValidator(lambda name: _plain_name(name))]
GridFileName = Annotated[str, AfterValidator(lambda name: _plain_name(name, ".npz"))]
Name = Annotated[str, AfterValidator(_identifier)]


class Table(BaseModel):
    """A table of an experiment file. Unknown keys are errors, and values are immutable."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    @classmethod
    def tag(cls) -> str:
        """Returns the name with which pydantic names the table if a field allows several tables."""
        return TAG + cls.__name__

    @property
    def files(self) -> list[str]:
        """Names of the files that the table needs."""
        return []


def fail(where: str, given: Any, allowed: str) -> NoReturn:
    """Raises a validation error for the key `where` of a table."""
    raise PydanticCustomError(
        "table",
        "{where}: given {given}; allowed {allowed}",
        {"where": where, "given": str(given), "allowed": allowed},
    )
