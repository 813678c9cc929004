"""A batch of free swimmers, each at its steady speed."""

import functools as ft

import jax
import numpy as np

from slider_jax.parameters import Scalar
from slider_jax.performance import Performance, next_stride, performance
from slider_jax.steady import Search, find_steady
from slider_jax.striding import Member, Plan

UNITS = {
    "speed": "m_per_s",
    "wavelength": "m",
    "wave_speed": "m_per_s",
    "power": "W",
    "thrust": "N",
    "force_efficiency": "N_per_W",
    "tail_amplitude": "m",
    "head_amplitude": "m",
    "turning": "rad_per_stride",
}
"""Of quantities of `Performance`; the others have none."""


def columns(found: Performance) -> dict[str, Scalar]:
    """Quantities by their names with units."""
    return {
        f"{name}_{UNITS[name]}" if name in UNITS else name: value
        for name, value in vars(found).items()
    }


@ft.partial(jax.jit, static_argnums=0)
def _seen(search: Search, members: Member):
    def one(member):
        found = find_steady(member.model, member.frequency, search)
        stride = next_stride(member.model, member.frequency, found.carry, search)
        return performance(member.model, member.frequency, stride, search), found.ok

    return jax.vmap(one)(members)


def swim_steadily(plan: Plan, members: Member) -> dict[str, np.ndarray]:
    """Quantities (members,) of steady strides, named with their units.

    NaN for a member that failed or has no steady speed.
    """
    search = Search(steps_per_stride=plan.steps_per_stride, numerics=plan.numerics)
    found, ok = _seen(search, members)
    table = {name: np.asarray(values) for name, values in columns(found).items()}
    return {name: np.where(ok, values, np.nan) for name, values in table.items()}
