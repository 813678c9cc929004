"""Names the chambers of a robot, and converts between chamber pressures and signed pressures. This
module imports no other room."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any, Literal


@dataclass(frozen=True)
class PneumaticActuator:
    """A pair of a left and a right chamber (side "both"), or a single chamber on one side.

    As in the simulator and in the experiment files, the signed pressure of an actuator is the
    pressure of the left chamber minus that of the right chamber.
    """

    name: str
    side: Literal["both", "left", "right"] = "both"
    limit: float = inf
    """Highest set pressure [Pa]. A drive with a larger set pressure is refused."""
    column: str = ""
    """Column of the signed pressure in a trial's CSV file; "" for the column p_NAME_Pa."""

    @property
    def left(self) -> bool:
        """Whether the actuator has a left chamber."""
        return self.side != "right"

    @property
    def right(self) -> bool:
        """Whether the actuator has a right chamber."""
        return self.side != "left"

    def possible(self, signed: float) -> float:
        """Returns the signed pressure [Pa], or 0 if it has the side of a chamber that is absent."""
        return (max(signed, 0.0) if self.left else 0.0) + (min(signed, 0.0) if self.right else 0.0)


@dataclass(frozen=True)
class ChamberLayout:
    """The pneumatic actuators of a robot, from the head to the tail.

    The chambers are in the order of the manifold: actuator by actuator, left before right.
    """

    actuators: tuple[PneumaticActuator, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the chambers: NAME_left and NAME_right for a pair, NAME for a single chamber."""
        sides = {"both": ("_left", "_right")}
        return tuple(x.name + end for x in self.actuators for end in sides.get(x.side, ("",)))

    @property
    def limits(self) -> tuple[float, ...]:
        """Highest set pressure [Pa] of each chamber."""
        return tuple(x.limit for x in self.actuators for _ in range(x.left + x.right))

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the actuators' signed pressures in a trial's CSV file."""
        return tuple(x.column or f"p_{x.name}_Pa" for x in self.actuators)

    @property
    def set_columns(self) -> tuple[str, ...]:
        """Columns of the actuators' signed set pressures in a .played.csv file."""
        return tuple(f"set_{x.name}_Pa" for x in self.actuators)

    def signed(self, pressures: Iterable[Any]) -> tuple[Any, ...]:
        """Returns the signed pressure of each actuator from the pressures of the chambers.

        The pressures may be numbers or arrays. Values after the last chamber are ignored.
        """
        given = iter(pressures)
        return tuple(
            (next(given) if x.left else 0) - (next(given) if x.right else 0) for x in self.actuators
        )

    def split(self, signed: Sequence[float]) -> tuple[float, ...]:
        """Returns the chambers' gauge pressures [Pa] from the actuators' signed pressures [Pa].

        Only one chamber of a pair is pressurised. A single chamber ignores pressures of the other
        side.
        """
        found: list[float] = []
        for actuator, p in zip(self.actuators, signed, strict=True):
            found += [max(p, 0.0)] * actuator.left + [max(-p, 0.0)] * actuator.right
        return tuple(found)


SLIDER = ChamberLayout((PneumaticActuator("front"), PneumaticActuator("rear")))
"""SLIDER's two pairs of chambers. Without an experiment file, the robot is SLIDER."""
