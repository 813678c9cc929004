"""What may be asked of the chambers: no number goes on the wire that has not come through here."""

from collections.abc import Sequence
from math import isfinite
from typing import NamedTuple

from rig.errors import RigError
from rig.protocol.messages import CHAMBERS, Ident

HIGHEST = 2_000_000.0
"""Gauge pressure [Pa] above which a limit is taken for a mistake of units."""


class PressureLimits(NamedTuple):
    """Highest set gauge pressure of each chamber [Pa]."""

    front_left: float
    front_right: float
    rear_left: float
    rear_right: float

    @classmethod
    def of(cls, pressures: Sequence[float], where: str = "limits") -> "PressureLimits":
        """One for all chambers, or one for each. Raises `RigError`, naming `where` they are."""
        if len(pressures) not in (1, 4):
            raise RigError.value(
                where, f"{len(pressures)} pressures", "one for all chambers, or four",
                f"their order is {', '.join(CHAMBERS)}",
            )  # fmt: skip
        limits = cls(*(list(pressures) * 4)[:4])
        for name, limit in zip(CHAMBERS, limits, strict=True):
            if not 1e3 <= limit <= HIGHEST:
                raise RigError.value(
                    f"{where}, {name}", f"{limit:g}", f"1e3 to {HIGHEST:g} Pa", "not kPa or psi"
                )
        return limits

    def within(self, ident: Ident) -> "PressureLimits":
        """These, if the manifold allows them. Raises `RigError`."""
        for name, limit in zip(CHAMBERS, self, strict=True):
            hard = getattr(ident, name)
            if limit > hard:
                raise RigError.value(
                    f"limit of {name}", f"{limit:g} Pa", f"at most {hard} Pa, which the manifold's "
                    "firmware is built for", "lower it"
                )  # fmt: skip
        return self


def checked_pressures(
    pressures: Sequence[float], limits: PressureLimits
) -> tuple[int, int, int, int]:
    """Set gauge pressures (4,) in whole pascals, as the wire has them. Raises `RigError`.

    What is above a limit is an error, not cut: a gait that was cut is another gait.
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
