"""What the designer of a swimmer chooses: how it is driven, and the tail that it is driven with."""

from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp

from slider_jax.actuation import SquareWave
from slider_jax.effects.base import WaterMotion, of_place
from slider_jax.errors import InputError
from slider_jax.model import Drive, Model
from slider_jax.parameters import Scalar
from slider_jax.supports import Free


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


def swimmer(model: Model, gait: Gait | None = None) -> Model:
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
    if gait is None:
        return model
    robot = replace(model.robot, tail_length=gait.tail_length, EI_tail=gait.EI_tail)
    front = SquareWave(gait.frequency, gait.front)
    rear = SquareWave(gait.frequency, gait.rear, gait.phase)
    return replace(model, robot=robot, drive=Drive(front, rear))
