"""Every effect by name: what a file may add to a model, and what a residual may be traced to."""

from slider_jax.effects.base import Effect
from slider_jax.effects.camera_delay import CameraDelay
from slider_jax.effects.camera_scale import CameraScale
from slider_jax.effects.clamp_compliance import ClampCompliance
from slider_jax.effects.force_clock_offset import ForceClockOffset
from slider_jax.effects.force_crosstalk import ForceCrosstalk
from slider_jax.effects.force_gain import ForceGain
from slider_jax.effects.force_resonance import ForceResonance
from slider_jax.effects.force_sensor_lag import ForceSensorLag
from slider_jax.effects.gravity import Gravity
from slider_jax.effects.pressure_gain import PressureGain
from slider_jax.effects.pressure_offset import PressureOffset
from slider_jax.effects.pressure_sensor_lag import PressureSensorLag
from slider_jax.effects.tangential_friction import TangentialFriction
from slider_jax.effects.valve_delay import ValveDelay

LIBRARY: dict[str, type[Effect]] = {
    effect.name(): effect
    for effect in (
        # command, flow, acting pressure
        ValveDelay,
        # body and mounting
        ClampCompliance,
        # water
        Gravity,
        TangentialFriction,
        # instruments
        PressureGain,
        PressureOffset,
        PressureSensorLag,
        ForceGain,
        ForceCrosstalk,
        ForceSensorLag,
        ForceResonance,
        ForceClockOffset,
        CameraDelay,
        CameraScale,
    )
}
