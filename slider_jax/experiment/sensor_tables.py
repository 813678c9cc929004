"""Tables of the sensors: errors of the built-in channels, and further channels."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from slider_jax.experiment.tables import FROM_LIST, Force, Length, Name, Share, Table, fail
from slider_jax.io.units import Quantity

Columns = Annotated[tuple[str, ...], FROM_LIST, Field(min_length=1, max_length=3)]
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
tank, m. Three columns, with dimension = 3: x, y and z in the tank, m |
    | `curvature` | curvature, 1/m |
    | `angle`, `turning_rate` | angle of the body, rad, and its rate, rad/s; an inertial sensor |
    | `speed` | forward speed of the head in the tank, m/s |

    `noise` is the standard deviation of the white noise in the unit of the reading; with 0, the
    noise is estimated from the data. `tare` is the standard deviation of an offset that is constant
    in a trial. `gain` and `discrepancy` are as in table [sensors].
    """

    kind: Literal[
        "pressure", "thrust", "recoil", "yaw_moment", "tip", "marker", "curvature", "angle",
        "turning_rate", "speed",
    ]  # fmt: skip
    name: Name | None = None
    columns: Columns
    actuator: Name | None = None
    s: Length | None = None
    noise: Annotated[float, Quantity(0.0, 1e5)] = 0.0
    tare: Annotated[float, Quantity(0.0, 1e5)] = 0.0
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
        if len(self.columns) > 1 and self.kind != "marker":
            fail("columns", list(self.columns), f"1 column for the kind {self.kind}")
        if self.name is not None and self.kind in BUILT_IN_KINDS:
            fail("name", repr(self.name), f"nothing: the kind {self.kind} has a name")
        if self.name is None and self.kind in AT_A_PLACE:
            fail("name", "nothing", f"a name, because a robot can have several {self.kind}s")
        return self


class SensorsTable(Table):
    """[sensors]: standard deviations and correlation time of sensor errors, and sample rate.

    Gains are fractions of the reading, and discrepancies are fractions of the channel's rms.
    """

    pressure_noise: Annotated[float, Quantity(0.0, 1e5, "Pa")] = 0.0
    force_noise: Force = 0.0
    force_tare: Force = 0.0
    force_slow_noise: Force = 0.0
    force_slow_time: Annotated[float, Quantity(1e-3, 100.0, "s")] = 0.1
    tip_noise: Annotated[float, Quantity(0.0, 0.1, "m")] = 0.0
    start_swing: Annotated[float, Quantity(0.0, 0.1, "m")] = 0.0
    pressure_gain: Share | None = None
    thrust_gain: Share | None = None
    recoil_gain: Share | None = None
    tip_gain: Share | None = None
    pressure_discrepancy: Share | None = None
    thrust_discrepancy: Share | None = None
    recoil_discrepancy: Share | None = None
    tip_discrepancy: Share | None = None
    sample_rate: Annotated[float, Quantity(1.0, 1e5, "Hz")] = 500.0
    channels: Annotated[tuple[ChannelTable, ...], FROM_LIST] = ()
