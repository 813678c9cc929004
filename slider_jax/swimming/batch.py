"""A batch of free swimmers, each at its steady speed."""

from collections.abc import Callable

import jax
import numpy as np
from jaxtyping import Array

from slider_jax.batch.strides import Member, Plan
from slider_jax.beam.parameters import Scalar
from slider_jax.swimming.performance import Performance, steady_stride
from slider_jax.swimming.steady_state import SteadySettings

UNITS = {
    "speed": "m_per_s",
    "wavelength": "m",
    "wave_speed": "m_per_s",
    "power": "W",
    "thrust": "N",
    "force_efficiency": "N_per_W",
    "tail_amplitude": "m",
    "head_amplitude": "m",
    "shape_wavelength": "m",
    "turning": "rad_per_stride",
}
"""Of quantities of `Performance`; the others have none."""


def performance_columns(found: Performance) -> dict[str, Scalar]:
    """Quantities by their names with units."""
    return {
        f"{name}_{UNITS[name]}" if name in UNITS else name: value
        for name, value in vars(found).items()
    }


def compile_swim(plan: Plan, chunk: Member) -> Callable[[Member], tuple[Performance, Array]]:
    """Compile for members stacked as in `chunk`: what their steady strides amount to, and ok."""
    search = SteadySettings(
        steps_per_stride=plan.steps_per_stride, numerics=plan.numerics, scheme=plan.scheme
    )

    def one(member):
        _, found, ok = steady_stride(member.model, member.frequency, search)
        return found, ok

    return jax.jit(jax.vmap(one)).lower(chunk).compile()


def performance_table(found: Performance, ok: Array) -> dict[str, np.ndarray]:
    """Quantities (members,) of steady strides, named with their units; NaN where not `ok`."""
    table = {name: np.asarray(values) for name, values in performance_columns(found).items()}
    return {name: np.where(ok, values, np.nan) for name, values in table.items()}
