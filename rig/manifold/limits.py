"""Limits of the chambers' set pressures. Every set pressure is checked here before it is sent."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

from rig.chambers import ChamberLayout
from rig.errors import RigError
from rig.protocol.messages import Ident

LARGEST_LIMIT = 2_000_000.0
"""Highest gauge pressure that is allowed as a limit [Pa]. A higher value may have a wrong unit."""


@dataclass(frozen=True)
class PressureLimits:
    """Highest allowed set pressure of each chamber, a gauge pressure [Pa]."""

    chambers: tuple[str, ...]
    """Names of the chambers, in the order of the manifold."""
    pressures: tuple[float, ...]

    @classmethod
    def of(
        cls, pressures: Sequence[float], layout: ChamberLayout, where: str = "limits"
    ) -> "PressureLimits":
        """Returns the limits from one pressure for all chambers, or from one for each chamber [Pa].

        The limit of a chamber is at most that of its actuator. Raises `RigError` for a wrong number
        or value of pressures. Its message starts with `where`.
        """
        names, count = layout.names, len(layout.names)
        if len(pressures) not in (1, count):
            raise RigError.value(
                where, f"{len(pressures)} pressures", f"one for all chambers, or {count}",
                f"their order is {', '.join(names)}",
            )  # fmt: skip
        given = tuple(pressures) * (count if len(pressures) == 1 else 1)
        for name, limit in zip(names, given, strict=True):
            if not 1e3 <= limit <= LARGEST_LIMIT:
                raise RigError.value(
                    f"{where}, {name}",
                    f"{limit:g}",
                    f"1e3 to {LARGEST_LIMIT:g} Pa",
                    "not kPa or psi",
                )
        return cls(names, tuple(map(min, given, layout.limits)))

    def within(self, ident: Ident) -> "PressureLimits":
        """Returns these limits.

        Raises `RigError` if the manifold has another number of chambers than the robot, or if a
        limit exceeds the manifold's hard limit.
        """
        given, there = len(self.chambers), len(ident.limits)
        if given != there:
            raise RigError(
                f"chambers: the robot has {given} ({', '.join(self.chambers)}), but the manifold "
                f"has {there}; give the experiment file of the robot that is connected, or connect "
                "the robot's own manifold"
            )
        for name, limit, hard in zip(self.chambers, self.pressures, ident.limits, strict=True):
            if limit > hard:
                raise RigError.value(
                    f"limit of {name}", f"{limit:g} Pa",
                    f"at most {hard} Pa, the hard limit of the manifold's firmware",
                )  # fmt: skip
        return self

    def checked(self, pressures: Sequence[float]) -> tuple[int, ...]:
        """Returns the chambers' set gauge pressures in whole pascals, for the protocol's messages.

        Raises `RigError` for a pressure below 0 or above its limit. Clipping would change the gait.
        """
        if len(pressures) != len(self.chambers):
            raise RigError.value(
                "set pressures", len(pressures), f"{len(self.chambers)}: {', '.join(self.chambers)}"
            )
        for name, pressure, limit in zip(self.chambers, pressures, self.pressures, strict=True):
            if not isfinite(pressure) or not 0.0 <= pressure <= limit:
                raise RigError.value(
                    f"set pressure of {name}", f"{pressure:g} Pa", f"0 to its limit, {limit:g} Pa",
                    "the smallest of the actuator's `limit` and the limits of rig file and command",
                )  # fmt: skip
        return tuple(int(p) for p in pressures)
