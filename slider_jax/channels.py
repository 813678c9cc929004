"""Defines the channels. A channel is the signal of one sensor, with CSV column, units and noise.

All code that reads, simulates, plots or fits sensor data iterates over `CHANNELS`. To add a sensor,
define a `Channel` and `register` this channel before you load data:

    register(Channel("tail_speed", "tail_speed_m_per_s", "m/s", "tail speed", "m/s", 1.0, observe))
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Array

from slider_jax import observables as obs
from slider_jax.dynamics.step import Snapshot
from slider_jax.effects import Effect, Instrument, Readings, of_place
from slider_jax.errors import InputError

TIME = "t_s"
"""Column of the sample times, in s."""


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
    observe: Callable[[Snapshot], Array]
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
    start: Callable[[np.ndarray], float] = lambda midline: 0.0
    """Returns the reading at t = 0 from the midline (2, nodes) [m]; not used for pressures."""


CHANNELS: dict[str, Channel] = {}
"""All channels by name. Arrays of readings have one row per channel, in the order of this dict."""


def register(channel: Channel) -> Channel:
    """Adds a channel to `CHANNELS` and returns the channel.

    Raises `InputError` if another channel has the same name or column.
    """
    taken = {TIME} | {x.column for x in CHANNELS.values()}
    if channel.name in CHANNELS or channel.column in taken:
        known = ", ".join(f"{x.name} ({x.column})" for x in CHANNELS.values())
        raise InputError(
            f"channel {channel.name} (column {channel.column}): this name or column is already "
            f"registered; registered channels: {known}; choose another name and column"
        )
    CHANNELS[channel.name] = channel
    return channel


def _pressure(name: str, label: str, chamber: int) -> Channel:
    return Channel(
        name, f"{name}_Pa", "Pa", label, "kPa", 1e-3, lambda x: x.chambers.p[chamber],
        "pressure", "pressure_noise", "pressure", gain=0.002, discrepancy=0.002, digits=".1f",
    )  # fmt: skip


def _force(name: str, observe: Callable[[Snapshot], Array], discrepancy: float) -> Channel:
    return Channel(
        name, f"{name}_N", "N", name, "mN", 1e3, observe,
        "force", "force_noise", name, gain=0.01, discrepancy=discrepancy, digits=".6f",
    )  # fmt: skip


# Model-discretisation discrepancies (see the glossary) of twelve noise-free trials, in % of rms:
# pressures 0.05 to 0.3, thrust 5 to 28 (median 7), recoil 0.7 to 2.1, tip 0.1 to 0.9.
register(_pressure("p_front", "front pressure", 0))
register(_pressure("p_rear", "rear pressure", 1))
register(_force("thrust", obs.thrust, 0.07))
register(_force("recoil", obs.recoil, 0.012))
register(Channel(
    "tip", "tip_m", "m", "tip, lateral", "mm", 1e3, obs.tip,
    "camera", "tip_noise", "tip", gain=0.005, discrepancy=0.005, digits=".7f",
    start=lambda midline: midline[1, 0],
))  # fmt: skip
BUILT_IN = tuple(CHANNELS)
"""Names of the channels that this file registers; the rig's live stream has the same channels."""


def channel_columns() -> tuple[str, ...]:
    """Returns the columns of a measured or simulated CSV file: the time and all channels."""
    return TIME, *(channel.column for channel in CHANNELS.values())


def row_of(name: str) -> int:
    """Returns the row of a channel in arrays of readings: the channel's position in `CHANNELS`."""
    return list(CHANNELS).index(name)


def true_readings(x: Snapshot) -> dict[str, Array]:
    """Returns the true reading of every channel, in SI units."""
    return {name: channel.observe(x) for name, channel in CHANNELS.items()}


def recorded(effects: tuple[Effect, ...], true: Readings) -> Readings:
    """Returns the readings that the sensors record: `true`, changed by all `Instrument` effects."""
    for effect in of_place(effects, Instrument):
        true = effect.read(true)
    return true


def recorded_series(
    effects: tuple[Effect, ...], t: Array, true: dict[str, Array]
) -> dict[str, Array]:
    """Returns the recorded series (n,) of each channel at times `t` (n,) [s] from `true` series.

    `Instrument` effects change only the built-in channels.
    """
    read = recorded(effects, Readings(t, *(true[name] for name in BUILT_IN)))
    return true | dict(zip(BUILT_IN, read[1:], strict=True))
