"""From set pressure to bending moment."""

from slider_jax.actuation.moment import chamber_windows as chamber_windows
from slider_jax.actuation.pressure import (
    FirstOrderLag as FirstOrderLag,
    Ideal as Ideal,
    PressureLaw as PressureLaw,
    pressure_history as pressure_history,
)
from slider_jax.actuation.waveform import (
    Recorded as Recorded,
    SineWave as SineWave,
    SquareWave as SquareWave,
    Trapezoid as Trapezoid,
    Waveform as Waveform,
)
