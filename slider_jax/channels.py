"""Defines the channels. A channel is the signal of one sensor, with CSV column, units and noise.

All code that reads, simulates, plots or fits sensor data iterates over a `ChannelSet`, which
`channels_of` returns for the chambers of a robot. To add a sensor to every robot, define a
`Channel` and `register` this channel before you load data:

    register(Channel("tail_speed", "tail_speed_m_per_s", "m/s", "tail speed", "m/s", 1.0, observe))
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from slider_jax import observables as obs
from slider_jax.effects import Effect, Instrument, Readings, of_place
from slider_jax.errors import InputError

TIME = "t_s"
"""Column of the sample times, in s."""


def zero_at_start(midline: np.ndarray) -> float:
    """Returns 0. The function has a name, because programs of unnamed functions are not kept."""
    return 0.0


@dataclass(frozen=True)
class Channel:
    """The signal of one sensor. `observe` returns the true reading from a simulated snapshot."""

    name: str
    column: str
    """Name of the channel's column in a trial's CSV file."""
    unit: str
    """SI unit of the column."""
    label: str
    """Name of the channel in plots and printed lines."""
    plot_unit: str
    plot_factor: float
    """Factor that converts a reading from `unit` to `plot_unit`."""
    observe: Callable[[obs.AnySnapshot], Array]
    kind: Literal["pressure", "force", "camera", "other"] = "other"
    """Kind of sensor: forces have a tare and slow noise; pressures have a quantisation step."""
    noise: str = ""
    """Key of the white noise in table [sensors]. If "", the noise is estimated from the data."""
    share_key: str = ""
    """Start of the keys `..._gain` and `..._discrepancy` in table [sensors]. If "", the constants
    below always apply."""
    gain: float = 0.01
    """Standard deviation of a trial's gain (scale factor), due to calibration error and drift, if
    none is declared."""
    discrepancy: float = 0.05
    """Largest model-discretisation discrepancy, as a fraction of the channel's rms. It applies if
    no discrepancy is declared or measured."""
    digits: str = ".7g"
    """Python format specification of the numbers in the CSV column."""
    white: float = 0.0
    """Standard deviation of the white noise, in `unit`, of a channel without the key `noise`. If 0,
    the noise is estimated from the data."""
    tare: float = 0.0
    """Standard deviation, in `unit`, of an offset that is constant in a trial."""
    start: Callable[[np.ndarray], float] | None = zero_at_start
    """Returns the reading at t = 0 from the midline (2, nodes) [m]; not used for pressures. With
    None, the reading is extrapolated from the next readings."""


@dataclass(frozen=True)
class ChannelSet(Mapping[str, Channel]):
    """The channels of an experiment by name. Arrays of readings have one row per channel."""

    members: tuple[Channel, ...]

    def __post_init__(self) -> None:
        for i, x in enumerate(self.members):
            others = self.members[:i]
            if x.name in (y.name for y in others) or x.column in (
                TIME,
                *(y.column for y in others),
            ):
                known = ", ".join(f"{y.name} ({y.column})" for y in others)
                raise InputError(
                    f"channel {x.name} (column {x.column}): another channel has this name or "
                    f"column; other channels: {known}; choose another name and column"
                )

    def __getitem__(self, name: str) -> Channel:
        return self.members[self.row(name)]

    def __iter__(self) -> Iterator[str]:
        return (x.name for x in self.members)

    def __len__(self) -> int:
        return len(self.members)

    def row(self, name: str) -> int:
        """Returns the row of a channel in arrays of readings. Raises `KeyError`."""
        for i, x in enumerate(self.members):
            if x.name == name:
                return i
        raise KeyError(name)

    def rows(self, names: Iterable[str]) -> list[int]:
        """Returns the rows of the channels `names`. Raises `KeyError`."""
        return [self.row(name) for name in names]

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns of a measured or simulated CSV file: the time and all channels."""
        return TIME, *(x.column for x in self.members)

    @property
    def without_start(self) -> tuple[str, ...]:
        """Names of the channels whose reading at t = 0 is extrapolated from the next readings."""
        return tuple(x.name for x in self.members if x.start is None)

    @property
    def pressures(self) -> tuple[str, ...]:
        """Names of the pressure channels, from the head to the tail."""
        return tuple(x.name for x in self.members if x.kind == "pressure")

    def observe(self, x: obs.AnySnapshot) -> dict[str, Array]:
        """Returns the true reading of every channel, in SI units."""
        return {channel.name: channel.observe(x) for channel in self.members}

    def readings(self, t: Array, true: Mapping[str, Array]) -> Readings:
        """Returns the series `true` of the channels at times `t` [s], as instruments read them."""
        pressures = [true[name] for name in self.pressures]
        empty = jnp.zeros((0, *jnp.shape(t)))
        return Readings(
            t, jnp.stack(pressures) if pressures else empty, *(true[name] for name in OF_BODY)
        )

    def recorded(
        self, effects: tuple[Effect, ...], t: Array, true: dict[str, Array]
    ) -> dict[str, Array]:
        """Returns the recorded series (n,) of each channel from the `true` series at `t` (n,) [s].

        `Instrument` effects change the pressures, thrust, recoil and tip.
        """
        read = recorded(effects, self.readings(t, true))
        named = dict(zip(self.pressures, read.pressures, strict=True))
        return true | named | {name: getattr(read, name) for name in OF_BODY}


@dataclass(frozen=True)
class ChamberPressure:
    """Returns the pressure [Pa] of a chamber from a snapshot."""

    chamber: int

    def __call__(self, x: obs.AnySnapshot) -> Array:
        return x.chambers.p[self.chamber]


def _pressure(chamber: str, index: int) -> Channel:
    name = f"p_{chamber}"
    return Channel(
        name, f"{name}_Pa", "Pa", f"{chamber} pressure", "kPa", 1e-3, ChamberPressure(index),
        "pressure", "pressure_noise", "pressure", gain=0.002, discrepancy=0.002, digits=".1f",
    )  # fmt: skip


def _force(name: str, observe: Callable[[obs.AnySnapshot], Array], discrepancy: float) -> Channel:
    return Channel(
        name, f"{name}_N", "N", name, "mN", 1e3, observe,
        "force", "force_noise", name, gain=0.01, discrepancy=discrepancy, digits=".6f",
    )  # fmt: skip


def _lateral_of_tip(midline: np.ndarray) -> float:
    return midline[1, 0]


# Model-discretisation discrepancies (see the glossary) of twelve noise-free trials, in % of rms:
# pressures 0.05 to 0.3, thrust 5 to 28 (median 7), recoil 0.7 to 2.1, tip 0.1 to 0.9.
_BODY = (
    _force("thrust", obs.thrust, 0.07),
    _force("recoil", obs.recoil, 0.012),
    Channel(
        "tip", "tip_m", "m", "tip, lateral", "mm", 1e3, obs.tip,
        "camera", "tip_noise", "tip", gain=0.005, discrepancy=0.005, digits=".7f",
        start=_lateral_of_tip,
    ),
)  # fmt: skip
OF_BODY = tuple(x.name for x in _BODY)
"""Names of the channels that every robot has, whatever its chambers are."""
REGISTERED: list[Channel] = []
"""Channels that `register` added to every experiment."""


def channels_of(chambers: Sequence[str]) -> ChannelSet:
    """Returns the built-in channels of a robot whose chambers have the names `chambers`.

    Raises `InputError` if two channels have the same name or column.
    """
    pressures = (_pressure(name, i) for i, name in enumerate(chambers))
    return ChannelSet((*pressures, *_BODY, *REGISTERED))


def register(channel: Channel) -> Channel:
    """Adds a channel to every experiment that is loaded from now on, and returns the channel.

    Raises `InputError` if another channel has the same name or column.
    """
    ChannelSet((*SLIDER_CHANNELS.members, *REGISTERED, channel))
    REGISTERED.append(channel)
    return channel


SLIDER_CHANNELS = channels_of(("front", "rear"))
"""The channels of SLIDER; the rig's live stream has the same channels."""


def recorded(effects: tuple[Effect, ...], true: Readings) -> Readings:
    """Returns the readings that the sensors record: `true`, changed by all `Instrument` effects."""
    for effect in of_place(effects, Instrument):
        true = effect.read(true)
    return true
