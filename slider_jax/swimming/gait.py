"""What a designer chooses, drive and tail; and the robot set free to swim, or pinned to climb."""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp

from slider_jax.actuation import SineWave, SquareWave, Trapezoid, Waveform
from slider_jax.beam.parameters import G, Scalar
from slider_jax.dynamics.model import Drive, Model
from slider_jax.effects.base import ForceDensity, Mounting, WaterMotion, of_place
from slider_jax.effects.body.gravity import Gravity
from slider_jax.effects.body.tip_mass import TipMass
from slider_jax.errors import InputError
from slider_jax.experiment.schema import Trial
from slider_jax.supports import Free, PinnedLink

Wave = SquareWave | SineWave | Trapezoid
CAP = 172.3e3
"""Highest set pressure [Pa] of the paper's climbing robot."""
LINK = 0.03
"""Length [m] of its cross-link."""


class Gait(NamedTuple):
    """A drive and a tail, SI units; the six variables of the paper's optimisation."""

    frequency: Scalar
    """f [Hz]"""
    front: Scalar
    """P_head, amplitude of the set pressure of the chamber behind the head [Pa]."""
    rear: Scalar
    """P_tail, of the chamber before the tail [Pa]."""
    phase: Scalar
    """phi, by which the rear chamber is late, fraction of a period."""
    tail_length: Scalar
    """L_tail [m]"""
    EI_tail: Scalar
    """[N m^2]"""


def to_swimmer(model: Model, gait: Gait | None = None) -> Model:
    """The robot of `model` set free in still water, with a `gait` instead of its own if given.

    Raises `InputError` where an effect moves the water, as speed is told against it.
    """
    moving = of_place(model.effects, WaterMotion)
    if moving:
        raise InputError(
            f"effects: given {moving[0].name()}, which moves the water; a free swimmer's speed is "
            "told against it: leave it out"
        )
    model = replace(model, support=Free(), water=(jnp.zeros(()), jnp.zeros(())))
    return model if gait is None else driven(model, gait)


def to_climber(
    model: Model,
    frequency: Scalar,
    pin_phase: Scalar,
    gait: Gait | None = None,
    link: Scalar = LINK,
    cap: Scalar = CAP,
) -> Model:
    """The robot of `model` in air, head up, pinned through a `link` [m] at alternating sides.

    The left end is pinned for the first half of each period 1/`frequency` [Hz], from `pin_phase`
    of a period on; where no pressure is set it stays pinned. Weight acts on it; forces of the water
    and what clamped it do not. Amplitudes of the set pressures are cut to `cap` [Pa]. Raises
    `InputError` for a mass at the tail's tip, whose weight is not known.
    """
    if of_place(model.effects, TipMass):
        raise InputError(
            "effects: given tip_mass, which has inertia but no weight here; leave it out to climb"
        )
    if gait is not None:
        model = driven(model, gait)
    front, rear = _capped(model.drive.front, cap), _capped(model.drive.rear, cap)
    is_driven = (front.amplitude != 0.0) | (rear.amplitude != 0.0)
    kept = [e for e in model.effects if not isinstance(e, (WaterMotion, Mounting, Gravity))]
    kept = [e for e in kept if not isinstance(e, ForceDensity) or e.in_air]
    model = replace(
        model,
        effects=(Gravity(G), *kept),
        drive=replace(model.drive, front=front, rear=rear),
        support=PinnedLink(link, jnp.where(is_driven, frequency, 0.0), pin_phase),
        water=(0.0, 0.0),
    )
    return jax.tree.map(lambda x: jnp.asarray(x, float), model)


def _capped(wave: Waveform, cap: Scalar) -> Wave:
    assert isinstance(wave, Wave)
    return replace(wave, amplitude=jnp.clip(wave.amplitude, -cap, cap))


def driven(model: Model, gait: Gait) -> Model:
    """The robot of `model` with the tail of a `gait`, driven by its square waves."""
    robot = replace(model.robot, tail_length=gait.tail_length, EI_tail=gait.EI_tail)
    front = SquareWave(gait.frequency, gait.front)
    rear = SquareWave(gait.frequency, gait.rear, gait.phase)
    return replace(model, robot=robot, drive=Drive(front, rear))


def stride_frequency(trial: Trial) -> float:
    """[Hz]. Raises `InputError` for a trial whose drive has no strides."""
    if trial.waveform == "recorded" or trial.frequency is None:
        raise InputError(
            f"{trial.file}: is driven by a recording, which has no strides; allowed are square, "
            "sine and trapezoid waves"
        )
    return trial.frequency
