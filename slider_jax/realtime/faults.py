"""Defines faults of a plant: leaking chambers, blocked valves and a changed tail stiffness."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slider_jax.effects import Flow
from slider_jax.errors import InputError, refuse_unknown

CHAMBERS = ("front_left", "front_right", "rear_left", "rear_right")
"""The four chambers, in the order of set pressures and readings."""


class Faults(NamedTuple):
    """Fault values, which may change between steps. Array axes: (front, rear), (left, right)."""

    leak: Float[Array, "2 2"] | np.ndarray
    """Leak rate [1/s]: conductance of the leak divided by the capacity of the chamber."""
    blocked: Float[Array, "2 2"] | np.ndarray
    """Blocked fraction of the fill valve's flow [-]."""
    EI_tail: Float[Array, ""] | np.ndarray
    """Bending stiffness of the tail [N m^2]."""


class ChamberFaults(Flow):
    """Blocked fill valves and leaks of single chambers.

        dp/dt = (1 - b) r - q p    while |p| increases,    r - q p    while |p| decreases

    p is the signed pressure. r is dp/dt from the pressure law and all other effects. b and q are
    values of the left chamber if p > 0, otherwise of the right chamber. Source: see `Leakage`.
    """

    title = "faults of single chambers"

    leak: Float[Array, "2 2"]
    """Leak rate q [1/s]."""
    blocked: Float[Array, "2 2"]
    """Blocked fraction b [-]."""

    def rate(self, rate, x):
        q, b = (jnp.where(x.side > 0.0, v[:, 0], v[:, 1]) for v in (self.leak, self.blocked))
        return jnp.where(x.filling, (1.0 - b) * rate, rate) - q * x.p


def no_faults(EI_tail: float) -> Faults:
    """Returns fault values of an intact robot with the tail stiffness `EI_tail` [N m^2]."""
    return Faults(np.zeros((2, 2)), np.zeros((2, 2)), np.asarray(EI_tail))


ALLOWED = {
    **{f"leak_{chamber}": (0.0, 100.0, "1/s") for chamber in CHAMBERS},
    **{
        f"blocked_{chamber}": (0.0, 1.0, "fraction of the fill valve's flow")
        for chamber in CHAMBERS
    },
    "EI_tail": (1e-6, 100.0, "N m^2"),
}
"""Lowest value, highest value and unit of each fault."""


def with_fault(faults: Faults, name: str, value: float) -> Faults:
    """Returns faults with one changed value. Raises `InputError` for an invalid name or value."""
    refuse_unknown("fault", [name], ALLOWED)
    low, high, unit = ALLOWED[name]
    if not low <= value <= high:
        raise InputError.value(f"fault {name}", value, f"{low:g} to {high:g}, {unit}")
    if name == "EI_tail":
        return faults._replace(EI_tail=np.asarray(float(value)))
    kind, _, chamber = name.partition("_")
    changed = getattr(faults, kind).copy()
    changed.flat[CHAMBERS.index(chamber)] = value
    return faults._replace(**{kind: changed})
