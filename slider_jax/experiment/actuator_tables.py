"""Tables of the actuators."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from slider_jax.experiment.tables import FROM_LIST, FileName, Name, Span, Table, fail
from slider_jax.io.units import Quantity

Ratio = Annotated[float, Quantity(0.01, 100.0)]
Limit = Annotated[float, Quantity(1e3, 2e6, "Pa")]
Stiffening = Annotated[float, Quantity(0.0, 1e-4, "N m^2/Pa")]
ENDS = BeforeValidator(lambda x: (x, x) if isinstance(x, (int, float)) else x)
Angle = Annotated[float, Quantity(-6.2832, 6.2832, "rad")]
Angles = Annotated[tuple[Angle, Angle], FROM_LIST, ENDS]


class ChamberTable(Table):
    """[[actuators]]: an air chamber that bends the body between two distances from the head.

    With `side` "both", the actuator is a pair: a left and a right chamber, whose signed pressure is
    left minus right. A single chamber takes only the set pressures of its side. In three
    dimensions, `angle` turns the plane in which the chamber bends the body. A chamber with a
    `distance` from the axis also twists the body if its two angles differ (a helix), or if the body
    is twisted.
    """

    kind: Literal["pneumatic"]
    name: Name
    span: Span
    K_Q_ratio: Ratio = 1.0
    side: Literal["both", "left", "right"] = "both"
    limit: Limit | None = None
    stiffening: Stiffening = 0.0
    k_ratio: Ratio = 1.0
    angle: Angles = (0.0, 0.0)
    distance: Annotated[float, Quantity(1e-4, 0.5, "m")] | None = None

    @model_validator(mode="after")
    def _helix_has_a_distance(self) -> Self:
        if self.angle[0] != self.angle[1] and self.distance is None:
            fail("distance", "nothing", "a length in m, because the angle changes along the span")
        return self

    @property
    def chambers(self) -> tuple[str, ...]:
        """Names of the chambers: NAME_left and NAME_right for a pair, NAME for a single chamber."""
        return (f"{self.name}_left", f"{self.name}_right") if self.side == "both" else (self.name,)

    def acts_on(self, side: Literal["left", "right"]) -> bool:
        """Whether the actuator has a chamber on this side of the body."""
        return self.side in ("both", side)


Phase = Annotated[float, Quantity(-1.0, 1.0, "fraction of a period")]
Offset = Annotated[float, Quantity(-0.5, 0.5, "m")]


class TendonTable(Table):
    """[[actuators]]: a tendon at the `offset` from the axis; a positive offset is on the left.

    The motor pulls with a `tension`, or it pulls in a length (`pull`) of a tendon with a
    `stiffness`. The command is bias + effort amplitude wave(t), with the trial's waveform and
    `effort`. A recorded drive has the column NAME_N or NAME_m. In three dimensions, `angle` is the
    direction of the offset about the axis; two angles give a helix.
    """

    kind: Literal["tendon"]
    name: Name
    span: Span
    offset: Annotated[tuple[Offset, Offset], FROM_LIST, ENDS]
    tension: Annotated[float, Quantity(0.0, 1e4, "N")] | None = None
    pull: Annotated[float, Quantity(-0.5, 0.5, "m")] | None = None
    stiffness: Annotated[float, Quantity(1.0, 1e8, "N/m")] | None = None
    pushes: Annotated[bool, Field(strict=True)] = False
    phase: Phase = 0.0
    bias: Annotated[float, Quantity(-1e4, 1e4, "N or m")] = 0.0
    angle: Angles = (0.0, 0.0)

    @property
    def amplitude(self) -> float:
        """Amplitude of the tension [N] or of the pulled length [m]."""
        return self.tension if self.tension is not None else self.pull or 0.0

    @property
    def column(self) -> str:
        """Column of the command in a recorded drive."""
        return f"{self.name}_{'N' if self.pull is None else 'm'}"

    @model_validator(mode="after")
    def _is_driven_in_one_way(self) -> Self:
        if (self.tension is None) == (self.pull is None):
            both = "tension and pull" if self.pull is not None else "nothing"
            fail("tension", both, "either tension or pull")
        if (self.pull is None) != (self.stiffness is None):
            text = "nothing" if self.stiffness is None else f"{self.stiffness:g}"
            fail("stiffness", text, "a stiffness in N/m with the key pull, otherwise nothing")
        if self.pushes and self.pull is None:
            fail("pushes", "true", "true only with the key pull")
        return self


class MomentTable(Table):
    """[[actuators]]: a moment from a measured table of commands and curvatures.

    The command is bias + effort amplitude wave(t), in the unit of the table. A recorded drive has
    the column NAME.
    """

    kind: Literal["moment"]
    name: Name
    span: Span
    table: FileName
    amplitude: Annotated[float, Quantity(-1e9, 1e9)] = 1.0
    phase: Phase = 0.0
    bias: Annotated[float, Quantity(-1e9, 1e9)] = 0.0

    @property
    def column(self) -> str:
        """Column of the command in a recorded drive."""
        return self.name

    @property
    def files(self) -> list[str]:
        return [self.table]


Curvature = Annotated[float, Quantity(-1000.0, 1000.0)]


class ShapeTable(Table):
    """[[actuators]]: the body follows a curvature, whatever moment is necessary.

    The curvature is a wave with the trial's frequency, or samples in the CSV file `file`.
    """

    kind: Literal["shape"]
    name: Name
    span: Span
    wavelength: Annotated[float, Quantity(-100.0, 100.0, "m")] | None = None
    amplitude: Annotated[tuple[Curvature, Curvature, Curvature], FROM_LIST] | None = None
    phase: Phase = 0.0
    bias: Curvature = 0.0
    file: FileName | None = None

    @property
    def files(self) -> list[str]:
        return [] if self.file is None else [self.file]

    @model_validator(mode="after")
    def _has_one_source(self) -> Self:
        for name in ("wavelength", "amplitude"):
            given = getattr(self, name)
            if (given is None) == (self.file is None):
                text = "nothing" if given is None else given
                fail(name, text, "a value without the key file, nothing with it")
        if self.wavelength == 0.0:
            fail("wavelength", 0.0, "a length other than 0")
        return self


ActuatorTable = ChamberTable | TendonTable | MomentTable | ShapeTable
TABLES: dict[str, type[ActuatorTable]] = {
    "pneumatic": ChamberTable,
    "tendon": TendonTable,
    "moment": MomentTable,
    "shape": ShapeTable,
}


def _of_kind(given: Any) -> Any:
    """Returns the table of an actuator's kind, so that errors name only the keys of this kind."""
    if not isinstance(given, dict):
        return given
    kind = given.get("kind")
    table = TABLES.get(kind) if isinstance(kind, str) else None
    if table is None:
        fail("kind", "nothing" if kind is None else repr(kind), ", ".join(TABLES))
    return table.model_validate(given)


AnyActuator = Annotated[ActuatorTable, BeforeValidator(_of_kind)]


def check_actuators(actuators: Mapping[str, ActuatorTable], body: float, length: float) -> None:
    """Raises an error if the actuators do not fit a robot.

    The key of an actuator is the key of its span in the file, such as actuators.0.span. `body` and
    `length` are the lengths [m] of the body and of the robot.
    """
    last: ChamberTable | None = None
    before: list[ActuatorTable] = []
    for here, x in actuators.items():
        near, far = x.span
        most, what = (body, "body") if isinstance(x, ChamberTable) else (length, "robot")
        if near >= far:
            fail(here, list(x.span), "[near, far] with near < far, from the head")
        if far > most * (1.0 + 1e-9):
            fail(here, list(x.span), f"spans within the {what}, 0 to {most:g} m")
        if x.name in [y.name for y in before]:
            name = f"{here.rpartition('.')[0]}.name"
            fail(name, repr(x.name), "a name that no other actuator has")
        if isinstance(x, ChamberTable):
            pairs = [y for y in before if isinstance(y, ChamberTable)]
            taken = {name for y in pairs for name in y.chambers}
            if not taken.isdisjoint(x.chambers):
                name = f"{here.rpartition('.')[0]}.name"
                allowed = f"another name, because the chambers {', '.join(sorted(taken))} exist"
                fail(name, repr(x.name), allowed)
        other = next((y for y in before if _overlap(x, y)), None)
        if other is not None:
            allowed = f"a span outside of {list(other.span)} m, the span of {other.name}"
            fail(here, list(x.span), allowed)
        if isinstance(x, ChamberTable):
            if last is not None and near < last.span[0]:
                allowed = f"a near end of at least {last.span[0]:g} m: list chambers from the head"
                fail(here, list(x.span), allowed)
            last = x
        before.append(x)


def _overlap(x: ActuatorTable, y: ActuatorTable) -> bool:
    """Whether two chambers on one side overlap, or a prescribed shape and another actuator."""
    near, far = max(x.span[0], y.span[0]), min(x.span[1], y.span[1])
    if isinstance(x, ChamberTable) and isinstance(y, ChamberTable):
        alike = any(x.acts_on(side) and y.acts_on(side) for side in ("left", "right"))
    else:
        alike = isinstance(x, ShapeTable) or isinstance(y, ShapeTable)
    return alike and near < far * (1.0 - 1e-9)
