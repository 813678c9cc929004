"""From set pressure to bending moment."""

from slider_jax.actuation.moment import chamber_windows as chamber_windows
from slider_jax.actuation.pressure import (
    FirstOrderLag as FirstOrderLag,
)
from slider_jax.actuation.pressure import (
    Ideal as Ideal,
)
from slider_jax.actuation.pressure import (
    PressureLaw as PressureLaw,
)
from slider_jax.actuation.pressure import (
    pressure_history as pressure_history,
)
from slider_jax.actuation.waveform import (
    Recorded as Recorded,
)
from slider_jax.actuation.waveform import (
    SineWave as SineWave,
)
from slider_jax.actuation.waveform import (
    SquareWave as SquareWave,
)
from slider_jax.actuation.waveform import (
    Trapezoid as Trapezoid,
)
from slider_jax.actuation.waveform import (
    Waveform as Waveform,
)
