"""Set pressures, pressure lag and moment of the chambers. This package may import `beam`."""

from slider_jax.actuation.moment import chamber_windows
from slider_jax.actuation.pressure import FirstOrderLag, Ideal, PressureLaw
from slider_jax.actuation.waveform import (
    Biased,
    Clipped,
    Held,
    Recorded,
    SineWave,
    SquareWave,
    Trapezoid,
    Waveform,
    rear_of,
    waves_along,
)

__all__ = [
    "Biased",
    "Clipped",
    "FirstOrderLag",
    "Held",
    "Ideal",
    "PressureLaw",
    "Recorded",
    "SineWave",
    "SquareWave",
    "Trapezoid",
    "Waveform",
    "chamber_windows",
    "rear_of",
    "waves_along",
]
