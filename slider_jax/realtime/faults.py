"""What can break while a plant runs: a chamber leaks, a valve is blocked, the tail changes."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slider_jax.effects import Flow
from slider_jax.errors import InputError, did_you_mean

CHAMBERS = ("front_left", "front_right", "rear_left", "rear_right")
"""The four chambers, in the order of set pressures and readings."""


class Faults(NamedTuple):
    """Numbers that may change between two steps. `leak` and `blocked` by segment, then side."""

    leak: Float[Array, "2 2"] | np.ndarray
    """Conductance of a leak over the chamber's capacity [1/s]."""
    blocked: Float[Array, "2 2"] | np.ndarray
    """Share of the fill valve's flow that is missing."""
    EI_tail: Float[Array, ""] | np.ndarray
    """Bending stiffness of the tail [N m^2]."""


class ChamberFaults(Flow):
    """A fill valve that passes less than it should, and a leak, each of one chamber.

        dp/dt = (1 - b) r - q p    while |p| grows,    r - q p    while it falls

    r is the flow with all else, b and q are of the chamber that holds p: the left one where p > 0.
    Source: as `Leakage`.
    """

    title = "faults of single chambers"

    leak: Float[Array, "2 2"]
    """q [1/s]."""
    blocked: Float[Array, "2 2"]
    """b [-]."""

    def rate(self, rate, x):
        q, b = (jnp.where(x.side > 0.0, v[:, 0], v[:, 1]) for v in (self.leak, self.blocked))
        return jnp.where(x.filling, (1.0 - b) * rate, rate) - q * x.p


def no_faults(EI_tail: float) -> Faults:
    """No fault; `EI_tail` [N m^2] is the tail's own."""
    return Faults(np.zeros((2, 2)), np.zeros((2, 2)), np.asarray(EI_tail))


ALLOWED = {
    **{f"leak_{chamber}": (0.0, 100.0, "1/s") for chamber in CHAMBERS},
    **{f"blocked_{chamber}": (0.0, 1.0, "share of the fill valve's flow") for chamber in CHAMBERS},
    "EI_tail": (1e-6, 100.0, "N m^2"),
}
"""Faults by name: least and largest value, and unit."""


def with_fault(faults: Faults, name: str, value: float) -> Faults:
    """The faults with one set anew. Raises `InputError` for another name, or a value outside."""
    if name not in ALLOWED:
        raise InputError(
            f"fault: given {name!r}; allowed {', '.join(ALLOWED)}{did_you_mean(name, ALLOWED)}"
        )
    low, high, unit = ALLOWED[name]
    if not low <= value <= high:
        raise InputError.value(f"fault {name}", value, f"{low:g} to {high:g}, {unit}")
    if name == "EI_tail":
        return faults._replace(EI_tail=np.asarray(float(value)))
    kind, _, chamber = name.partition("_")
    changed = getattr(faults, kind).copy()
    changed.flat[CHAMBERS.index(chamber)] = value
    return faults._replace(**{kind: changed})
