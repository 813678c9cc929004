"""Physical effects of pneumatics, body, water and sensors. Each file defines one effect. This
package may import `actuation`, `supports` and packages of lower layers."""

from slider_jax.effects.base import (
    MOUNT_LAG as MOUNT_LAG,
    ActingPressure as ActingPressure,
    BendingMoment as BendingMoment,
    BodyChange as BodyChange,
    Chamber as Chamber,
    Command as Command,
    Curve as Curve,
    Effect as Effect,
    Flow as Flow,
    ForceDensity as ForceDensity,
    HeadRates as HeadRates,
    Instrument as Instrument,
    Mounting as Mounting,
    Prior as Prior,
    Readings as Readings,
    WakeForce as WakeForce,
    WaterMotion as WaterMotion,
    in_space as in_space,
    mean_of_others as mean_of_others,
    of_place as of_place,
    parameter as parameter,
    shape_parameter as shape_parameter,
    states_at_rest as states_at_rest,
    total_force as total_force,
    total_load as total_load,
)
from slider_jax.effects.body.gravity import Gravity as Gravity
from slider_jax.effects.water.drag import NormalDrag as NormalDrag
from slider_jax.effects.water.reactive import ReactiveForce as ReactiveForce
