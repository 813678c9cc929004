"""Tables of the actuators, and of the sensors beyond the built-in ones."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from slider_jax.experiment.tables import FROM_LIST, Length, Name, Share, Span, Table, fail
from slider_jax.io.units import Quantity

Ratio = Annotated[float, Quantity(0.01, 100.0)]
Limit = Annotated[float, Quantity(1e3, 2e6, "Pa")]


class ChamberTable(Table):
    """[[actuators]]: an air chamber that bends the body between two distances from the head.

    With `side` "both", the actuator is a pair: a left and a right chamber, whose signed pressure is
    left minus right. A single chamber takes only the set pressures of its side.
    """

    kind: Literal["pneumatic"]
    name: Name
    span: Span
    K_Q_ratio: Ratio = 1.0
    side: Literal["both", "left", "right"] = "both"
    limit: Limit | None = None

    def acts_on(self, side: Literal["left", "right"]) -> bool:
        """Whether the actuator has a chamber on this side of the body."""
        return self.side in ("both", side)

    def overlaps(self, other: "ChamberTable") -> bool:
        """Whether both actuators have a chamber on the same side at the same place."""
        near, far = max(self.span[0], other.span[0]), min(self.span[1], other.span[1])
        sides = any(self.acts_on(x) and other.acts_on(x) for x in ("left", "right"))
        return sides and near < far * (1.0 - 1e-9)


def check_chambers(chambers: tuple[ChamberTable, ...], body: float) -> None:
    """Raises an error if the chambers do not fit a robot whose body has the length `body` [m]."""
    for i, x in enumerate(chambers):
        here, before = f"actuators.{i}", chambers[:i]
        near, far = x.span
        if near >= far:
            fail(f"{here}.span", list(x.span), "[near, far] with near < far, from the head")
        if far > body * (1.0 + 1e-9):
            fail(f"{here}.span", list(x.span), f"spans within the body, 0 to {body:g} m")
        if x.name in [y.name for y in before]:
            fail(f"{here}.name", repr(x.name), "a name that no other actuator has")
        other = next((y for y in before if x.overlaps(y)), None)
        if other is not None:
            allowed = f"a span outside of {list(other.span)}, the span of {other.name}"
            fail(f"{here}.span", list(x.span), allowed)
        if before and near < before[-1].span[0]:
            allowed = (
                f"a near end of at least {before[-1].span[0]:g} m: list actuators from the head"
            )
            fail(f"{here}.span", list(x.span), allowed)


Count = Annotated[tuple[str, ...], FROM_LIST, Field(min_length=1, max_length=2)]
BUILT_IN_KINDS = ("pressure", "thrust", "recoil", "tip")
"""Kinds of channels that exist without a table. Their tables change the column and the errors."""
AT_A_PLACE = ("marker", "curvature", "angle", "turning_rate")
"""Kinds of channels that have a place `s`."""


class ChannelTable(Table):
    """[[sensors.channels]]: a sensor's channel, and its columns in the trials' CSV files.

    | kind | reading |
    |---|---|
    | `pressure` | pressure of the `actuator`, Pa |
    | `thrust`, `recoil` | forward force and force to the left on the clamp, N |
    | `yaw_moment` | moment on the clamp, counter-clockwise from above, N m |
    | `tip` | lateral position of the tip relative to the head, m |
    | `marker` | one column: lateral position relative to the head, m. Two columns: x and y in the \
tank, m |
    | `curvature` | curvature, 1/m |
    | `angle`, `turning_rate` | angle of the body, rad, and its rate, rad/s; an inertial sensor |
    | `speed` | forward speed of the head in the tank, m/s |

    `noise` is the standard deviation of the white noise in the unit of the reading; with 0, the
    noise is estimated from the data. `gain` and `discrepancy` are as in table [sensors].
    """

    kind: Literal[
        "pressure", "thrust", "recoil", "yaw_moment", "tip", "marker", "curvature", "angle",
        "turning_rate", "speed",
    ]  # fmt: skip
    name: Name | None = None
    columns: Count
    actuator: Name | None = None
    s: Length | None = None
    noise: Annotated[float, Quantity(0.0, 1e5)] = 0.0
    gain: Share | None = None
    discrepancy: Share | None = None

    @model_validator(mode="after")
    def _keys_fit_the_kind(self) -> Self:
        if (self.kind in AT_A_PLACE) != (self.s is not None):
            given = "nothing" if self.s is None else self.s
            allowed = f"a distance from the head in m, only for {', '.join(AT_A_PLACE)}"
            fail("s", given, allowed)
        if (self.kind == "pressure") != (self.actuator is not None):
            given = "nothing" if self.actuator is None else repr(self.actuator)
            fail("actuator", given, "the name of an actuator, only for the kind pressure")
        most = 2 if self.kind == "marker" else 1
        if len(self.columns) > most:
            fail("columns", list(self.columns), f"{most} column for the kind {self.kind}")
        if self.name is not None and self.kind in BUILT_IN_KINDS:
            fail("name", repr(self.name), f"nothing: the kind {self.kind} has a name")
        if self.name is None and self.kind in AT_A_PLACE:
            fail("name", "nothing", f"a name, because a robot can have several {self.kind}s")
        return self
