"""Pressure histories of the two chambers with effects, as numpy arrays."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from slider_jax.actuation import FirstOrderLag, Recorded, SquareWave
from slider_jax.beam.parameters import uniform_robot
from slider_jax.dynamics import pressures as pneumatics
from slider_jax.dynamics.model import Drive, Model
from slider_jax.supports import Clamped
from tests.support.helpers import arrays

K, F, A = 0.087, 2.2, 250e3
LAG = FirstOrderLag(K)

chamber_history = eqx.filter_jit(pneumatics.chamber_history)


@eqx.filter_jit
def _history(model, times):
    begin = pneumatics.start_chambers(model)
    rest = pneumatics.chamber_history(model, begin, times)
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), begin, rest)


def pressure_history(law, waveform, start, times):
    """Returns the pressure [Pa] at increasing `times` [s]; it is `start` [Pa] at the first time."""
    segments = jax.vmap(waveform.segment)(times[:-1], times[1:])
    first = jnp.asarray(start, times.dtype)

    def body(p, segment):
        p = law.advance(p, segment)
        return p, p

    _, rest = jax.lax.scan(body, first, segments)
    return jnp.concatenate([first[None], rest])


def chambers(effects, front, rear, t, start=0.0, law=LAG):
    """Returns the chambers' history (n, ...) from the pressure `start` [Pa] in both."""
    model = Model(uniform_robot(), tuple(effects), law, Drive((front, rear), start), Clamped())
    model = arrays(model)
    count = len(t)
    # Few lengths occur, because each length has its own compiled program.
    missing = max(1024, 2 ** int(np.ceil(np.log2(count)))) - count
    more = t[-1] + (t[-1] - t[-2]) * np.arange(1, missing + 1)
    found = _history(model, jnp.asarray(np.concatenate([t, more])))
    return jax.tree.map(lambda x: np.asarray(x)[:count], found)


def held(p_set):
    """Returns a constant set pressure [Pa]."""
    return Recorded(jnp.asarray([-2.0, -1.0]), jnp.asarray([p_set, p_set]))


def relaxation(effect, start, p_set, t):
    """Returns the front pressure (n,) [Pa] from `start` for a constant set pressure."""
    return chambers([effect], held(p_set), held(p_set), t, start).p[:, 0]


def square(effects, t, **options):
    """Returns the chambers under square waves; the rear one lags by 0.15 of a period."""
    return chambers(effects, SquareWave(F, A), SquareWave(F, A, 0.15), t, **options)


def strides(per_stride, count=3):
    """Returns the times [s] of `count` strides with `per_stride` steps each."""
    return np.arange(0, count * per_stride + 1) / (F * per_stride)
