"""Set pressures, pressure lag and moment of the chambers, and the other actuators. This package may
import `beam`."""

from slider_jax.actuation.actuator import Actuator, Couple
from slider_jax.actuation.measured_moment import MeasuredMoment
from slider_jax.actuation.moment import chamber_windows
from slider_jax.actuation.prescribed_shape import (
    PrescribedShape,
    RecordedShape,
    TravellingWave,
    midline_shape,
    recorded_shape,
)
from slider_jax.actuation.pressure import FirstOrderLag, Ideal, PressureLaw
from slider_jax.actuation.tendon import LengthTendon, Tendon, TensionTendon
from slider_jax.actuation.waveform import Held, Recorded, SineWave, SquareWave, Trapezoid, Waveform

__all__ = [
    "Actuator",
    "Couple",
    "FirstOrderLag",
    "Held",
    "Ideal",
    "LengthTendon",
    "MeasuredMoment",
    "PrescribedShape",
    "PressureLaw",
    "Recorded",
    "RecordedShape",
    "SineWave",
    "SquareWave",
    "Tendon",
    "TensionTendon",
    "Trapezoid",
    "TravellingWave",
    "Waveform",
    "chamber_windows",
    "midline_shape",
    "recorded_shape",
]
