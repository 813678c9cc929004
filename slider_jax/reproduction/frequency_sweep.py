"""Runs the paper's head-fixed frequency sweep as one batch."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from slider_jax import paper
from slider_jax.batch.chunks import chunks_of, run_in_threads, stack, take
from slider_jax.batch.strides import BatchRobot, Plan, run_strides, steady_quantities
from slider_jax.beam.parameters import Numerics, Robot, uniform_robot
from slider_jax.channels import SLIDER_CHANNELS

SHOWN_FREQUENCIES = (1.0, 4.8)
"""Frequencies [Hz] of the paper's Figs. 5 and 6."""


class FrequencySweepSettings(eqx.Module):
    """Settings of the sweep. The command `slider demo` uses the defaults.

    With 400 or 500 instead of 300 steps per stride, the mean thrusts change by at most 0.02 mN.
    Steps per stride must be a multiple of 20: a time step then ends at each pressure step and pose.
    """

    robot: Robot = uniform_robot()
    assumed: paper.Assumed = paper.Assumed()
    frequencies: tuple[float, ...] = eqx.field(static=True, default=paper.SWEEP)
    steps_per_stride: int = eqx.field(static=True, default=300)
    strides: int = eqx.field(static=True, default=8)
    transient: int = eqx.field(static=True, default=paper.TRANSIENT_STRIDES)
    numerics: Numerics = Numerics()


class FrequencySeries(NamedTuple):
    """Time series of one frequency over all strides."""

    t: np.ndarray
    """Times (steps,) [s]."""
    channels: dict[str, np.ndarray]
    """Readings (steps,) of every channel, by the channel's name, in SI units."""
    midlines: np.ndarray
    """Midlines (poses, 2, nodes) [m] of the last stride, relative to the head."""


class FrequencySweep(NamedTuple):
    """Result for F frequencies. The names of the columns (F,) of `table` end with the unit."""

    table: dict[str, np.ndarray]
    stride_thrust: np.ndarray
    """Mean thrust (F, strides) [N] of every stride, including transient strides."""
    shown: dict[float, FrequencySeries]
    ok: np.ndarray
    """Whether all time steps converged (F,). Otherwise, the row in `table` is NaN."""


def run_frequency_sweep(
    settings: FrequencySweepSettings,
    on_begin: Callable[[int], None] = lambda strides: None,
    on_stride: Callable[[], None] = lambda: None,
) -> FrequencySweep:
    """Runs the sweep on all cores and returns its result.

    `on_begin` is called once with the number of strides of all chunks together. `on_stride` is
    called after each stride of a chunk.
    """
    frequencies = np.asarray(settings.frequencies, float)
    plan = Plan(settings.steps_per_stride, settings.strides, settings.numerics)
    robots = stack(
        [BatchRobot(paper.head_fixed(f, settings.robot, settings.assumed), f) for f in frequencies]
    )
    chunks = chunks_of(len(frequencies))
    on_begin(chunks.total * settings.strides)

    def work(chunk, stopped):
        runs = run_strides(plan, take(robots, chunks.indices(chunk)), on_stride, stopped)
        return {name: values[: chunks.distinct(chunk)] for name, values in runs.items()}

    done = dict(run_in_threads(work, list(range(chunks.total)), chunks.workers))
    parts = [done[chunk] for chunk in range(chunks.total)]
    runs = {name: np.concatenate([x[name] for x in parts]) for name in parts[0]}
    C_d, m_a = jax.vmap(paper.force_coefficients)(jnp.asarray(frequencies))
    table = {"frequency_Hz": frequencies, "C_d": np.asarray(C_d), "m_a": np.asarray(m_a)}
    table |= steady_quantities(plan, robots, runs, settings.transient)
    shown = {}
    for index, frequency in enumerate(frequencies):
        if np.isclose(frequency, SHOWN_FREQUENCIES).any():
            times, *readings = (
                np.concatenate(runs[name][index]) for name in ("t", *SLIDER_CHANNELS)
            )
            channels = dict(zip(SLIDER_CHANNELS, readings, strict=True))
            shown[float(frequency)] = FrequencySeries(times, channels, runs["midline"][index])
    return FrequencySweep(table, runs["thrust"].mean(axis=2), shown, runs["ok"])
