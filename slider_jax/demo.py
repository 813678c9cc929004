"""The paper's head-fixed frequency sweep: one vmapped rollout of all its frequencies."""

import threading
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from slider_jax import observables as obs
from slider_jax import paper
from slider_jax.batch import chunks_of, in_threads
from slider_jax.model import Model, make_mesh
from slider_jax.parameters import Numerics, Robot
from slider_jax.rollout import TimeGrid, rollout
from slider_jax.state import straight
from slider_jax.step import Carry, start

SHOWN = (1.0, 4.8)
"""Frequencies [Hz] of the paper's Figs. 5 and 6."""
POSES = 20
"""Midlines kept of the last stride."""


class Settings(eqx.Module):
    """What the sweep runs; the defaults are the demo's.

    At 400 and at 500 steps a stride every mean thrust of the sweep is the same to 0.02 mN. Steps
    per stride are a multiple of 20: edges of both chambers and poses then fall on steps.
    """

    robot: Robot = Robot()
    assumed: paper.Assumed = paper.Assumed()
    frequencies: tuple[float, ...] = eqx.field(static=True, default=paper.SWEEP)
    steps_per_stride: int = eqx.field(static=True, default=300)
    strides: int = eqx.field(static=True, default=8)
    transient: int = eqx.field(static=True, default=paper.TRANSIENT_STRIDES)
    numerics: Numerics = Numerics()


class Series(NamedTuple):
    """One frequency over all strides: arrays over the steps, (steps,) unless a shape is given."""

    t: np.ndarray
    """[s]"""
    pressure: np.ndarray
    """(steps, 2): front and rear [Pa]."""
    thrust: np.ndarray
    """[N]"""
    recoil: np.ndarray
    """[N]"""
    tip: np.ndarray
    """[m]"""
    midlines: np.ndarray
    """(poses, 2, nodes) [m], over the last stride; head at the origin."""


class Sweep(NamedTuple):
    """The result: `table` has a column (F,) for each quantity, named with its unit."""

    table: dict[str, np.ndarray]
    stride_thrust: np.ndarray
    """(F, strides): mean thrust [N] of every stride, transient ones included."""
    shown: dict[float, Series]
    ok: np.ndarray
    """(F,) False where a step did not converge; its row is NaN."""


class _Leg(NamedTuple):
    """What one stride hands to the next, for one frequency."""

    carry: Carry
    pressure: jax.Array


def _save(x) -> dict[str, jax.Array]:
    return {
        "pressure": x.pressure,
        "thrust": obs.thrust(x),
        "recoil": obs.recoil(x),
        "power": jnp.sum(obs.chamber_power(x)),
        "midline": obs.midline(x) - x.head[:, None],
    }


def _at_rest(settings: Settings, frequency) -> _Leg:
    model: Model = paper.head_fixed(frequency, settings.robot, settings.assumed)
    mesh = make_mesh(model.robot, settings.numerics)
    carry = start(model, mesh, *straight(settings.numerics.nodes))
    return _Leg(carry, jnp.zeros(2))


def _stride(settings: Settings, frequency, number, leg: _Leg):
    """One stride of one robot, carried on from `leg`: the next leg, and the stride's series."""
    model = paper.head_fixed(frequency, settings.robot, settings.assumed)
    drive = eqx.tree_at(
        lambda d: (d.start_front, d.start_rear), model.drive, (leg.pressure[0], leg.pressure[1])
    )
    model = eqx.tree_at(lambda m: m.drive, model, drive)
    steps = settings.steps_per_stride
    times = TimeGrid(h=1.0 / (frequency * steps), steps=steps, t0=number / frequency)
    out = rollout(model, times, _save, settings.numerics, begin=leg.carry, checkpoint=False)
    return _Leg(out.final, out.saved["pressure"][-1]), {"t": out.t} | out.saved


def compiled(settings: Settings, size: int):
    """The two programs of the sweep for chunks of `size` frequencies: rest, and one stride."""
    frequencies = jnp.ones((size,))
    rest = jax.jit(jax.vmap(lambda f: _at_rest(settings, f)))
    stride = jax.jit(jax.vmap(lambda f, n, leg: _stride(settings, f, n, leg), (0, None, 0)))
    legs = jax.eval_shape(rest, frequencies)
    return rest, stride.lower(frequencies, jnp.asarray(0.0), legs).compile()


def run_sweep(
    settings: Settings,
    on_compiled: Callable[[int], None] = lambda strides: None,
    on_stride: Callable[[], None] = lambda: None,
) -> Sweep:
    """Run the sweep on all cores, chunk by chunk and stride by stride.

    `on_compiled(n)` is called once, n chunk-strides being to come, and `on_stride()` after each.
    """
    frequencies = np.asarray(settings.frequencies, float)
    chunks = chunks_of(len(frequencies))
    rest, stride = compiled(settings, chunks.size)
    on_compiled(chunks.count * settings.strides)
    lock = threading.Lock()

    def work(chunk):
        batch = jnp.asarray(frequencies[chunks.indices(chunk)])
        legs, series = rest(batch), []
        for number in range(settings.strides):
            legs, saved = stride(batch, jnp.asarray(float(number)), legs)
            saved = {name: np.asarray(values) for name, values in saved.items()}
            midline = saved.pop("midline")
            series.append(saved | {"tip": midline[:, :, 1, 0]})
            with lock:
                on_stride()
        every = settings.steps_per_stride // POSES
        whole = {name: np.stack([x[name] for x in series], axis=1) for name in series[0]}
        whole |= {"midline": midline[:, every - 1 :: every], "ok": np.asarray(legs.carry.ok)}
        return {name: values[: chunks.real(chunk)] for name, values in whole.items()}

    done = dict(in_threads(work, list(range(chunks.count)), chunks.workers))
    parts = [done[chunk] for chunk in range(chunks.count)]
    return _collect(settings, {name: np.concatenate([x[name] for x in parts]) for name in parts[0]})


def _collect(settings: Settings, runs: dict[str, np.ndarray]) -> Sweep:
    """The sweep's result from series of shape (F, strides, steps, ...)."""
    frequencies = np.asarray(settings.frequencies, float)
    shown = {}
    for index, frequency in enumerate(frequencies):
        if np.isclose(frequency, SHOWN).any():
            whole = {name: np.concatenate(runs[name][index]) for name in _SERIES}
            shown[float(frequency)] = Series(**whole, midlines=runs["midline"][index])
    return Sweep(_table(settings, runs), runs["thrust"].mean(axis=2), shown, runs["ok"])


_SERIES = ("t", "pressure", "thrust", "recoil", "tip")


def _table(settings: Settings, runs: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """A column for each quantity, over the strides after the transient."""
    frequencies = jnp.asarray(settings.frequencies, float)
    thrust, recoil, power, tip = (
        runs[name][:, settings.transient :] for name in ("thrust", "recoil", "power", "tip")
    )
    per_stride = thrust.mean(axis=2)
    mean, mean_power = per_stride.mean(axis=1), power.mean(axis=(1, 2))
    s = make_mesh(settings.robot, settings.numerics).grid.s
    poses = runs["midline"].shape[1]

    def wave(frequency, lateral):
        t = jnp.arange(1, poses + 1) / (poses * frequency)
        mode = obs.fundamental_mode(lateral, t, frequency)
        return obs.body_wave(mode, s, frequency), obs.travelling_index(mode)

    waves, index = jax.jit(jax.vmap(wave))(frequencies, jnp.asarray(runs["midline"][:, :, 1]))
    C_d, m_a = jax.vmap(paper.force_coefficients)(frequencies)
    table = {
        "thrust_mean_N": mean,
        "thrust_std_of_strides_N": per_stride.std(axis=1, ddof=min(1, per_stride.shape[1] - 1)),
        "thrust_std_within_stride_N": thrust.std(axis=2).mean(axis=1),
        "recoil_peak_N": np.abs(recoil).max(axis=2).mean(axis=1),
        "recoil_rms_N": np.sqrt((recoil**2).mean(axis=(1, 2))),
        "tip_half_range_m": 0.5 * np.ptp(tip, axis=2).mean(axis=1),
        "chamber_power_W": mean_power,
        "force_efficiency_N_per_W": obs.force_efficiency(mean, mean_power),
        "body_wavelength_m": waves.wavelength,
        "wave_speed_m_per_s": waves.speed,
        "travelling_index": index,
    }
    known = {"frequency_Hz": frequencies, "C_d": C_d, "m_a": m_a}
    failed = ~runs["ok"]
    return {name: np.asarray(values) for name, values in known.items()} | {
        name: np.where(failed, np.nan, np.asarray(values)) for name, values in table.items()
    }
