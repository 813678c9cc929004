"""Set pressures, pressure lag and moment of the chambers, and the other actuators. This package may
import `beam`."""

from slider_jax.actuation.actuator import Actuator as Actuator, Couple as Couple
from slider_jax.actuation.measured_moment import MeasuredMoment as MeasuredMoment
from slider_jax.actuation.moment import chamber_windows as chamber_windows
from slider_jax.actuation.prescribed_shape import (
    PrescribedShape as PrescribedShape,
    RecordedShape as RecordedShape,
    TravellingWave as TravellingWave,
    midline_shape as midline_shape,
    recorded_shape as recorded_shape,
)
from slider_jax.actuation.pressure import (
    FirstOrderLag as FirstOrderLag,
    Ideal as Ideal,
    PressureLaw as PressureLaw,
)
from slider_jax.actuation.scheduled import ScheduledSquareWave as ScheduledSquareWave
from slider_jax.actuation.tendon import (
    LengthTendon as LengthTendon,
    Tendon as Tendon,
    TensionTendon as TensionTendon,
)
from slider_jax.actuation.waveform import (
    Biased as Biased,
    Clipped as Clipped,
    Held as Held,
    PeriodicSpline as PeriodicSpline,
    Recorded as Recorded,
    SineWave as SineWave,
    SquareWave as SquareWave,
    Trapezoid as Trapezoid,
    Waveform as Waveform,
    rear_of as rear_of,
    waves_along as waves_along,
)
