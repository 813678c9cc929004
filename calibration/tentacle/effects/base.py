"""Base class of the effects of the arm at rest. An effect models one physical cause.

`slider_jax.effects.base.parameter` declares each parameter: the null at which the effect vanishes,
the prior range, the unit and the reason for the range.
"""

from abc import abstractmethod
from typing import ClassVar

import equinox as eqx

from calibration.tentacle.arm import ArmParts


class AbstractArmEffect(eqx.Module):
    """One cause of an error of the predicted markers. Its fields are its parameters."""

    by_session: ClassVar[bool] = False
    """Whether a new set-up of the experiment can change the parameters."""
    uses_strains: ClassVar[bool] = False
    """Whether the effect depends on the strains of the arm."""

    @abstractmethod
    def on(self, parts: ArmParts) -> ArmParts:
        """Returns the parts of the arm with this effect."""
