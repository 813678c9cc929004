"""Limits of the chambers' set pressures. Every set pressure is checked here before it is sent."""

from collections.abc import Sequence
from math import isfinite
from typing import NamedTuple

from rig.errors import RigError
from rig.protocol.messages import CHAMBERS, Ident

LARGEST_LIMIT = 2_000_000.0
"""Highest gauge pressure that is allowed as a limit [Pa]. A higher value may have a wrong unit."""


class PressureLimits(NamedTuple):
    """Highest allowed set pressure of each chamber, a gauge pressure [Pa]."""

    front_left: float
    front_right: float
    rear_left: float
    rear_right: float

    @classmethod
    def of(cls, pressures: Sequence[float], where: str = "limits") -> "PressureLimits":
        """Returns the limits from one pressure for all chambers, or from four pressures [Pa].

        Raises `RigError` for a wrong number or value of pressures. Its message starts with `where`.
        """
        if len(pressures) not in (1, 4):
            raise RigError.value(
                where, f"{len(pressures)} pressures", "one for all chambers, or four",
                f"their order is {', '.join(CHAMBERS)}",
            )  # fmt: skip
        limits = cls(*(list(pressures) * 4)[:4])
        for name, limit in zip(CHAMBERS, limits, strict=True):
            if not 1e3 <= limit <= LARGEST_LIMIT:
                raise RigError.value(
                    f"{where}, {name}",
                    f"{limit:g}",
                    f"1e3 to {LARGEST_LIMIT:g} Pa",
                    "not kPa or psi",
                )
        return limits

    def within(self, ident: Ident) -> "PressureLimits":
        """Returns these limits. Raises `RigError` if a limit exceeds the manifold's hard limit."""
        for name, limit in zip(CHAMBERS, self, strict=True):
            hard = getattr(ident, name)
            if limit > hard:
                raise RigError.value(
                    f"limit of {name}", f"{limit:g} Pa",
                    f"at most {hard} Pa, the hard limit of the manifold's firmware",
                )  # fmt: skip
        return self


def checked_pressures(
    pressures: Sequence[float], limits: PressureLimits
) -> tuple[int, int, int, int]:
    """Returns the set gauge pressures (4,) in whole pascals, for the protocol's messages.

    Raises `RigError` for a pressure below 0 or above its limit. Clipping would change the gait.
    """
    if len(pressures) != len(CHAMBERS):
        raise RigError.value(
            "set pressures", f"{len(pressures)}", f"{len(CHAMBERS)}: {', '.join(CHAMBERS)}"
        )
    for name, pressure, limit in zip(CHAMBERS, pressures, limits, strict=True):
        if not isfinite(pressure) or not 0.0 <= pressure <= limit:
            raise RigError.value(
                f"set pressure of {name}", f"{pressure:g} Pa", f"0 to its limit, {limit:g} Pa"
            )
    a, b, c, d = (int(p) for p in pressures)
    return a, b, c, d
