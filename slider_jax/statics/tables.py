"""The tables of the file that describes a rod and its static loads."""

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from slider_jax.experiment.tables import FROM_LIST, FileName, Table, fail
from slider_jax.io.units import Quantity

Number = Annotated[float, Quantity(-1e9, 1e9)]
Vector = Annotated[tuple[Number, Number, Number], FROM_LIST]
CURVATURE = Quantity(-1e4, 1e4, "1/m")
Curvature = Annotated[float, CURVATURE]
Curvatures = Annotated[tuple[Curvature, Curvature, Curvature], FROM_LIST]
Acceleration = Annotated[float, Quantity(-100.0, 100.0, "m/s^2")]
Gravity = Annotated[tuple[Acceleration, Acceleration, Acceleration], FROM_LIST]
Length = Annotated[float, Quantity(1e-4, 1000.0, "m")]
Stiffness = Annotated[float, Quantity(1e-9, 1e9, "N m^2")]
AxialStiffness = Annotated[float, Quantity(1e-3, 1e12, "N")]
LinearDensity = Annotated[float, Quantity(0.0, 1e4, "kg/m")]
Area = Annotated[float, Quantity(0.0, 10.0, "m^2")]
Density = Annotated[float, Quantity(0.0, 2e4, "kg/m^3")]
Distance = Annotated[float, Quantity(-10.0, 10.0, "m")]
Place = Annotated[tuple[Distance, Distance], FROM_LIST]
Coordinate = Annotated[float, Quantity(-1000.0, 1000.0, "m")]
Point = Annotated[tuple[Coordinate, Coordinate, Coordinate], FROM_LIST]
Along = Annotated[float, Quantity(0.0, 1000.0, "m")]
Span = Annotated[tuple[Along, Along], FROM_LIST]
Tension = Annotated[float, Quantity(0.0, 1e6, "N")]
Pressure = Annotated[float, Quantity(-1e7, 1e7, "Pa")]
MomentPerPressure = Annotated[float, Quantity(1e-12, 1e-2, "m^3")]
Angle = Annotated[float, Quantity(-1000.0, 1000.0, "rad")]
Angles = Annotated[tuple[Angle, Angle], FROM_LIST]
Turns = Annotated[float, Quantity(-1000.0, 1000.0)]
Support = Literal["clamped", "hinged"]
Nodes = Annotated[int, Field(strict=True, ge=3, le=401)]

ROUNDING = 1e-6
"""Largest part of a vector along a forbidden direction, divided by the vector's length: of a normal
along the tangent, and of a force across the direction of sliding. Vectors of a file are rounded."""

PROFILE_COLUMNS = {
    "EI_n": "EI_n_N_m2",
    "EI_b": "EI_b_N_m2",
    "GJ": "GJ_N_m2",
    "EA": "EA_N",
    "linear_density": "linear_density_kg_per_m",
    "section_area": "section_area_m2",
}
"""Column of each property in the profile of a rod."""
CURVATURE_COLUMNS = ("curvature_t_per_m", "curvature_n_per_m", "curvature_b_per_m")
"""Columns of the initial curvature in the profile of a rod."""


class RodTable(Table):
    """Table [rod]. A property is a number here, or a column of the CSV file `profile`."""

    length: Length
    EI_n: Stiffness | None = None
    EI_b: Stiffness | None = None
    GJ: Stiffness | None = None
    EA: AxialStiffness | None = None
    linear_density: LinearDensity | None = None
    section_area: Area | None = None
    initial_curvature: Curvatures | None = None
    profile: FileName | None = None
    clamp_tangent: Vector = (1.0, 0.0, 0.0)
    clamp_normal: Vector = (0.0, 1.0, 0.0)
    start: Support = "clamped"

    @model_validator(mode="after")
    def _complete(self) -> Self:
        for name in ("EI_n", "EI_b", "GJ"):
            if getattr(self, name) is None and self.profile is None:
                fail(name, "nothing", "a number in N m^2, or a column of a profile")
        _axes(self, "clamp_tangent", "clamp_normal")
        return self


def _axes(table: Table, tangent: str, normal: str) -> None:
    """Refuses axes of a section that are zero or not at a right angle."""
    for name in (tangent, normal):
        if not any(getattr(table, name)):
            fail(name, list(getattr(table, name)), "a vector that is not zero")
    t, n = np.array(getattr(table, tangent)), np.array(getattr(table, normal))
    if abs(t @ n) > ROUNDING * np.linalg.norm(t) * np.linalg.norm(n):
        stated = n.tolist() if normal in table.model_fields_set else f"nothing, so {n.tolist()}"
        fail(normal, stated, "a vector at a right angle to the tangent")


class EndTable(Table):
    """Table [end]: a support that holds the far end of the rod."""

    kind: Support
    position: Point
    slides_along: Vector | None = None
    tangent: Vector | None = None
    normal: Vector | None = None
    turns: Turns | None = None

    @model_validator(mode="after")
    def _complete(self) -> Self:
        for name in ("tangent", "normal", "turns"):
            given = getattr(self, name)
            if self.kind == "hinged" and given is not None:
                fail(name, given, 'no value with kind = "hinged", which lets the end turn')
        if self.slides_along is not None and not any(self.slides_along):
            fail("slides_along", list(self.slides_along), "a vector that is not zero")
        if (self.tangent is None) != (self.normal is None):
            name, other = ("normal", "tangent") if self.normal is None else ("tangent", "normal")
            fail(name, "nothing", f"a vector, because {other} is given")
        if self.tangent is not None:
            _axes(self, "tangent", "normal")
        return self

    @property
    def sliding(self) -> np.ndarray:
        """The matrix that keeps the part of a vector along which the end can slide."""
        if self.slides_along is None:
            return np.zeros((3, 3))
        along = np.array(self.slides_along) / np.linalg.norm(self.slides_along)
        return np.outer(along, along)


class LoadTable(Table):
    """Table [load]: force and moment on the tip, gravity, and the density of the fluid."""

    force: Vector = (0.0, 0.0, 0.0)
    moment: Vector = (0.0, 0.0, 0.0)
    follower: Annotated[bool, Field(strict=True)] = False
    gravity: Gravity = (0.0, 0.0, 0.0)
    fluid_density: Density = 0.0


class _AlongRod(Table):
    """A table with a span along the rod."""

    span: Span

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.span[0] >= self.span[1]:
            allowed = "two distances in m from the start of the rod, the smaller one first"
            fail("span", list(self.span), allowed)
        return self


class RodTendonTable(_AlongRod):
    """A table [[tendons]]: a tendon that runs straight from one place in the section to another."""

    tension: Tension
    start: Place
    end: Place


class RodChamberTable(_AlongRod):
    """A table [[chambers]]: a pressure chamber beside the axis, straight or helical."""

    pressure: Pressure
    K_Q: MomentPerPressure
    distance: Length
    angles: Angles


class RodNumericsTable(Table):
    """Table [numerics]."""

    nodes: Nodes = 101


class StaticCaseTable(Table):
    """The file of `slider statics`."""

    name: str = "rod"
    rod: RodTable
    load: LoadTable = LoadTable()
    end: EndTable | None = None
    tendons: Annotated[tuple[RodTendonTable, ...], FROM_LIST] = ()
    chambers: Annotated[tuple[RodChamberTable, ...], FROM_LIST] = ()
    numerics: RodNumericsTable = RodNumericsTable()

    @model_validator(mode="after")
    def _inside(self) -> Self:
        for name in ("tendons", "chambers"):
            for i, x in enumerate(getattr(self, name)):
                if x.span[1] > self.rod.length * (1.0 + 1e-9):
                    fail(f"{name}.{i}.span", list(x.span), f"0 to {self.rod.length:g} m, the rod")
        return self

    @model_validator(mode="after")
    def _held(self) -> Self:
        end, load = self.end, self.load
        if end is None:
            if self.rod.start == "hinged":
                fail("rod.start", "hinged", "clamped, or hinged with a table [end]")
            return self
        if load.follower:
            fail("load.follower", True, "false with a table [end]")
        if end.kind == "clamped" and any(load.moment):
            fail("load.moment", list(load.moment), "zero, because the end is clamped")
        force = np.array(load.force)
        across = np.linalg.norm(force - end.sliding @ force)
        if across > ROUNDING * np.linalg.norm(force):
            allowed = "zero" if end.slides_along is None else "a force along end.slides_along"
            fail("load.force", list(load.force), f"{allowed}, because the support holds the end")
        return self
