"""Every effect by name: what a file may add to a model, and what a residual may be traced to."""

from slider_jax.effects.base import Effect
from slider_jax.effects.clamp_compliance import ClampCompliance
from slider_jax.effects.gravity import Gravity
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
    )
}
