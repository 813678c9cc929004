"""Builds the channels of an experiment from the tables [[sensors.channels]]."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from jaxtyping import Array

from slider_jax import observables as obs
from slider_jax.channels import Channel, ChannelSet, channels_of
from slider_jax.experiment.sensor_tables import BUILT_IN_KINDS, ChannelTable

Sensor = Literal["camera", "other"]
OTHER: Sensor = "other"
KINDS: dict[str, tuple[str, str, float, Sensor, float]] = {
    "marker": ("m", "mm", 1e3, "camera", 0.005),
    "curvature": ("1/m", "1/m", 1.0, OTHER, 0.01),
    "angle": ("rad", "rad", 1.0, OTHER, 0.01),
    "turning_rate": ("rad/s", "rad/s", 1.0, OTHER, 0.01),
    "yaw_moment": ("N m", "mN m", 1e3, OTHER, 0.012),
    "speed": ("m/s", "mm/s", 1e3, OTHER, 0.01),
}
"""Unit, unit in plots, factor to this unit, kind of sensor and discrepancy of each kind."""


@dataclass(frozen=True)
class AtPlace:
    """Returns `reading(snapshot, place)`, with the distance `place` [m] from the head."""

    reading: Callable[[obs.AnySnapshot, float], Array]
    place: float

    def __call__(self, x: obs.AnySnapshot) -> Array:
        return self.reading(x, self.place)


@dataclass(frozen=True)
class CoordinateOf:
    """Returns the coordinate `axis` (0: x, 1: y, 2: z) [m] of a point of the body in the tank."""

    place: float
    axis: int

    def __call__(self, x: obs.AnySnapshot) -> Array:
        return obs.point(x, self.place)[self.axis]


READINGS: dict[str, Callable[[obs.AnySnapshot, float], Array]] = {
    "marker": obs.lateral_at,
    "curvature": obs.curvature_at,
    "angle": obs.angle_at,
    "turning_rate": obs.turning_rate_at,
}
WHOLE: dict[str, Callable[[obs.AnySnapshot], Array]] = {
    "yaw_moment": obs.yaw_moment,
    "speed": obs.forward_speed,
}


def declared_channels(chambers: Sequence[str], tables: Sequence[ChannelTable]) -> ChannelSet:
    """Returns the built-in channels, changed and extended by the tables.

    Raises `InputError` if two channels have the same name or column.
    """
    members = {x.name: x for x in channels_of(chambers).members}
    added: list[Channel] = []
    for table in tables:
        if table.kind in BUILT_IN_KINDS:
            name = f"p_{table.actuator}" if table.kind == "pressure" else table.kind
            members[name] = _changed(members[name], table)
        else:
            added += _added(table)
    return ChannelSet((*members.values(), *added))


def _changed(channel: Channel, table: ChannelTable) -> Channel:
    """Returns a built-in channel with the column and the errors of its table."""
    channel = replace(channel, column=table.columns[0])
    if table.noise:
        channel = replace(channel, noise="", white=table.noise)
    if table.gain is not None or table.discrepancy is not None:
        channel = replace(channel, share_key="")
    return _with_errors(channel, table)


def _with_errors(channel: Channel, table: ChannelTable) -> Channel:
    gain, discrepancy = table.gain, table.discrepancy
    return replace(
        channel,
        tare=table.tare,
        gain=channel.gain if gain is None else gain,
        discrepancy=channel.discrepancy if discrepancy is None else discrepancy,
    )


def _added(table: ChannelTable) -> Iterator[Channel]:
    """Yields the channels of a table whose kind is not built in, one for each column."""
    name = table.name or table.kind
    unit, plot_unit, factor, sensor, discrepancy = KINDS[table.kind]
    for axis, column in enumerate(table.columns):
        several = len(table.columns) > 1
        own = f"{name}_{'xyz'[axis]}" if several else name
        observe: Callable[[obs.AnySnapshot], Array]
        if table.s is None:
            observe = WHOLE[table.kind]
        elif several:
            observe = CoordinateOf(table.s, axis)
        else:
            observe = AtPlace(READINGS[table.kind], table.s)
        yield _with_errors(
            Channel(
                own, column, unit, own.replace("_", " "), plot_unit, factor, observe, sensor,
                gain=0.005, discrepancy=discrepancy, white=table.noise, start=None,
            ),
            table,
        )  # fmt: skip
