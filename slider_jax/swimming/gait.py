"""Defines gaits (drive and tail), and models of a robot that swims freely or climbs a wall."""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from slider_jax.actuation import (
    Biased,
    Clipped,
    SineWave,
    SquareWave,
    Trapezoid,
    Waveform,
    waves_along,
)
from slider_jax.beam.parameters import G, Scalar
from slider_jax.dynamics.model import Drive, Model
from slider_jax.effects.base import ForceDensity, Mounting, WakeForce, WaterMotion, of_place
from slider_jax.effects.body.gravity import Gravity
from slider_jax.errors import InputError
from slider_jax.experiment.schema import Trial
from slider_jax.supports import Free, PinnedLink
from slider_jax.water import WaterField

Wave = SquareWave | SineWave | Trapezoid
CAP = 172.3e3
"""Highest set pressure [Pa] of the paper's climbing robot."""
LINK = 0.03
"""Length [m] of the cross-link of the paper's climbing robot."""


class Gait(NamedTuple):
    """A drive and a tail in SI units: the six variables of the paper's optimisation."""

    frequency: Scalar
    """Stride frequency f [Hz]."""
    front: Scalar
    """Amplitude P_head of the first chamber's set pressure [Pa]."""
    rear: Scalar
    """Amplitude P_tail of the last chamber's set pressure [Pa]; linear for chambers between."""
    phase: Scalar
    """Delay phi of the last chamber's set pressure, as a fraction of a period."""
    tail_length: Scalar
    """Length L_tail of the tail [m]."""
    EI_tail: Scalar
    """Bending stiffness of the tail [N m^2]."""


def to_swimmer(model: Model, gait: Gait | None = None) -> Model:
    """Returns the model of a free swimmer in still water, with drive and tail of `gait` if given.

    Raises `InputError` if an effect moves the water, or if the water is nonuniform: speeds are
    relative to still water. A free trial simulates a swimmer in moving water.
    """
    if isinstance(model.water, WaterField):
        raise InputError(
            "water: given a velocity field; a free swimmer's steady speed is relative to still "
            "water: remove `field` and `vortex_street`, or run `slider simulate` for a trial with "
            'support = "free"'
        )
    moving = of_place(model.effects, WaterMotion)
    if moving:
        raise InputError(
            f"effects: given {moving[0].name()}, which moves the water; a free swimmer's speed is "
            "relative to still water: remove this effect"
        )
    model = replace(model, support=Free(jnp.zeros(()), jnp.zeros(())), water=None)
    return model if gait is None else driven(model, gait)


def to_climber(
    model: Model,
    frequency: Scalar,
    pin_phase: Scalar,
    gait: Gait | None = None,
    link: Scalar = LINK,
    cap: Scalar = CAP,
) -> Model:
    """Returns the model of a climber in air, head up; both cross-link ends are pinned in turn.

    `link` is the cross-link's length [m]. The left end is pinned for the first half of each period
    1/`frequency` [Hz], starting at `pin_phase` (fraction of a period). If all set pressures are
    zero, the left end stays pinned. Weight acts on the body; hydrodynamic forces and the carriage
    clamp are omitted. Pressure amplitudes are limited to `cap` [Pa]. Raises `InputError` for an
    effect with inertia but without weight, such as a mass at the tail's tip.
    """
    for effect in model.effects:
        if effect.lacks_weight:
            raise InputError(
                f"effects: given {effect.name()}, which has inertia but no weight in this "
                "model; remove this effect to simulate climbing"
            )
    if gait is not None:
        model = driven(model, gait)
    waves = tuple(_capped(wave, cap) for wave in model.drive.waves)
    kept = [
        e for e in model.effects if not isinstance(e, (WaterMotion, WakeForce, Mounting, Gravity))
    ]
    kept = [e for e in kept if not isinstance(e, ForceDensity) or e.in_air]
    model = replace(
        model,
        effects=(Gravity(G), *kept),
        drive=replace(model.drive, waves=waves),
        support=PinnedLink(link, jnp.where(is_driven(model), frequency, 0.0), pin_phase),
        water=None,
    )
    return jax.tree.map(lambda x: jnp.asarray(x, float), model)


def _capped(wave: Waveform, cap: Scalar) -> Waveform:
    if isinstance(wave, Wave):
        return replace(wave, amplitude=jnp.clip(wave.amplitude, -cap, cap))
    return Clipped(wave, -cap, cap)


def is_driven(model: Model) -> Array:
    """Returns whether a periodic set pressure is not zero, or the robot has another actuator."""
    found = jnp.asarray(bool(model.actuators))
    for wave in model.drive.waves:
        found |= _is_driven(wave)
    return found


def _is_driven(wave: Waveform) -> Array:
    if isinstance(wave, Clipped):
        return _is_driven(wave.wave)
    if isinstance(wave, Biased):
        return _is_driven(wave.wave) | (jnp.asarray(wave.bias) != 0.0)
    assert isinstance(wave, Wave)
    return jnp.asarray(wave.amplitude) != 0.0


def driven(model: Model, gait: Gait) -> Model:
    """Returns the model with the tail and the square-wave drive of a gait.

    The limits of the chambers' set pressures remain.
    """
    robot = model.robot.with_tail(gait.tail_length, gait.EI_tail)
    waves = tuple(
        replace(old, wave=new) if isinstance(old, Clipped) else new
        for old, new in zip(model.drive.waves, gait_waves(gait, len(robot.chambers)), strict=True)
    )
    return replace(model, robot=robot, drive=Drive(waves))


def gait_waves(gait: Gait, chambers: int) -> tuple[Waveform, ...]:
    """Returns the square wave of each chamber's set pressure in a gait."""
    wave = partial(SquareWave, gait.frequency)
    return waves_along(wave, chambers, gait.front, gait.rear, gait.phase)


def stride_frequency(trial: Trial) -> float:
    """Returns a trial's frequency [Hz]. Raises `InputError` for a recorded drive."""
    if trial.waveform == "recorded" or trial.frequency is None:
        raise InputError(
            f"{trial.file}: the drive is a recording, which has no strides; allowed are square, "
            "sine and trapezoid waves"
        )
    return trial.frequency
