"""Physical effects, one in each file: pneumatics, body, water, sensors.

May import `actuation`, `supports` and the rooms below them.
"""

from slider_jax.effects.base import (
    MOUNT_LAG,
    ActingPressure,
    BendingMoment,
    BodyChange,
    Chamber,
    Command,
    Effect,
    Flow,
    ForceDensity,
    HeadRates,
    Instrument,
    Mounting,
    Prior,
    Readings,
    WaterMotion,
    of_place,
    parameter,
    total_force,
)
from slider_jax.effects.body.gravity import Gravity
from slider_jax.effects.water.drag import NormalDrag
from slider_jax.effects.water.reactive import ReactiveForce

__all__ = [
    "MOUNT_LAG",
    "ActingPressure",
    "BendingMoment",
    "BodyChange",
    "Chamber",
    "Command",
    "Effect",
    "Flow",
    "ForceDensity",
    "Gravity",
    "HeadRates",
    "Instrument",
    "Mounting",
    "NormalDrag",
    "Prior",
    "ReactiveForce",
    "Readings",
    "WaterMotion",
    "of_place",
    "parameter",
    "total_force",
]
