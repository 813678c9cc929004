"""Defines faults of a plant: leaking chambers, blocked valves and a changed tail stiffness."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slider_jax.effects import Flow
from slider_jax.errors import InputError, refuse_unknown
from slider_jax.experiment.actuator_tables import ChamberTable

Places = dict[str, tuple[int, int]]
"""The place of each chamber by name: number of the actuator, and 0 for left or 1 for right."""


def chamber_places(actuators: Sequence[ChamberTable]) -> Places:
    """Returns the places of all chambers, actuator by actuator, left before right."""
    columns = {"both": (0, 1), "left": (0,), "right": (1,)}
    return {
        name: (row, column)
        for row, x in enumerate(actuators)
        for name, column in zip(x.chambers, columns[x.side], strict=True)
    }


class Faults(NamedTuple):
    """Fault values, which may change between steps. Array axes: actuators, (left, right)."""

    leak: Float[Array, "actuators 2"] | np.ndarray
    """Leak rate [1/s]: conductance of the leak divided by the capacity of the chamber."""
    blocked: Float[Array, "actuators 2"] | np.ndarray
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

    leak: Float[Array, "actuators 2"]
    """Leak rate q [1/s]."""
    blocked: Float[Array, "actuators 2"]
    """Blocked fraction b [-]."""

    def rate(self, rate, x):
        q, b = (jnp.where(x.side > 0.0, v[:, 0], v[:, 1]) for v in (self.leak, self.blocked))
        return jnp.where(x.filling, (1.0 - b) * rate, rate) - q * x.p


def no_faults(actuators: int, EI_tail: float) -> Faults:
    """Returns fault values of an intact robot with the tail stiffness `EI_tail` [N m^2]."""
    return Faults(np.zeros((actuators, 2)), np.zeros((actuators, 2)), np.asarray(EI_tail))


ALLOWED = {
    "leak": (0.0, 100.0, "1/s"),
    "blocked": (0.0, 1.0, "fraction of the fill valve's flow"),
    "EI_tail": (1e-6, 100.0, "N m^2"),
}
"""Lowest value, highest value and unit of each kind of fault."""


def with_fault(faults: Faults, chambers: Places, name: str, value: float) -> Faults:
    """Returns faults with one changed value. Raises `InputError` for an invalid name or value."""
    known = {f"{kind}_{chamber}": kind for kind in ("leak", "blocked") for chamber in chambers}
    known["EI_tail"] = "EI_tail"
    refuse_unknown("fault", [name], known)
    kind = known[name]
    low, high, unit = ALLOWED[kind]
    if not low <= value <= high:
        raise InputError.value(f"fault {name}", value, f"{low:g} to {high:g}, {unit}")
    if kind == "EI_tail":
        return faults._replace(EI_tail=np.asarray(float(value)))
    changed = getattr(faults, kind).copy()
    changed[chambers[name.removeprefix(f"{kind}_")]] = value
    return faults._replace(**{kind: changed})
