"""Defines the table [transition] of an experiment file: from the water to the wall."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from slider_jax.experiment.tables import FROM_LIST, Table, fail
from slider_jax.io.units import Quantity

Pressure = Annotated[float, Quantity(1e3, 2e6, "Pa", or_zero=True)]


class SpinesTable(Table):
    """[transition.spines]: the microspines at each end of the cross-link."""

    stiffness: Annotated[float, Quantity(10.0, 1e6, "N/m")] = 4000.0
    damping: Annotated[float, Quantity(0.0, 1e4, "N s/m")] = 8.0
    friction: Annotated[float, Quantity(0.01, 100.0)] = 2.0
    preload: Annotated[float, Quantity(0.01, 1000.0, "N")] = 5.0
    pull_off: Annotated[float, Quantity(0.01, 1e4, "N")] = 15.0


class GaitAt(Table):
    """[[transition.schedule]]: the gait at one time; it changes linearly until the next time."""

    time: Annotated[float, Quantity(0.0, 600.0, "s")]
    frequency: Annotated[float, Quantity(0.05, 20.0, "Hz")]
    front: Pressure
    rear: Pressure
    phase: Annotated[float, Quantity(-1.0, 1.0, "fraction of a period")] = 0.0
    bias: Annotated[float, Quantity(-1e6, 1e6, "Pa")] = 0.0
    grip_phase: Annotated[float, Quantity(-1.0, 1.0, "fraction of a period")] = 0.0


class TransitionTable(Table):
    """[transition]: a robot that starts submerged, swims to a wall and climbs out of the water.

    The plane of motion is vertical, and the wall is a part of this plane. Heights are relative to
    the surface of the water.
    """

    depth: Annotated[float, Quantity(0.01, 10.0, "m")]
    height: Annotated[float, Quantity(-10.0, 10.0, "m")] = 0.5
    duration: Annotated[float, Quantity(0.1, 600.0, "s")] = 60.0
    start_speed: Annotated[float, Quantity(-3.0, 3.0, "m/s")] = 0.0
    heading: Annotated[float, Quantity(-3.1416, 3.1416, "rad")] = 0.0
    wall_from: Annotated[float, Quantity(-10.0, 10.0, "m")] = -0.1
    thickness: Annotated[float, Quantity(1e-3, 0.5, "m")] = 0.03
    link: Annotated[float, Quantity(0.005, 0.2, "m")] = 0.03
    spines: SpinesTable = SpinesTable()
    schedule: Annotated[tuple[GaitAt, ...], FROM_LIST, Field(min_length=1)]

    @model_validator(mode="after")
    def _schedule_is_ordered(self) -> Self:
        times = [x.time for x in self.schedule]
        if any(b <= a for a, b in zip(times, times[1:], strict=False)):
            fail("schedule", times, "times that increase from table to table")
        if self.height <= -self.depth:
            fail("height", self.height, f"more than {-self.depth:g} m, the height at the start")
        if self.wall_from > self.height:
            fail("wall_from", self.wall_from, f"at most the height of {self.height:g} m to reach")
        return self
