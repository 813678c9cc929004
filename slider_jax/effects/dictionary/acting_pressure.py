"""Terms of the pressure that bends the body."""

from abc import abstractmethod

import jax.numpy as jnp
from jaxtyping import Array

from slider_jax.actuation.waveform import rear_of
from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ActingPressure, Chamber, Curve, mean_of_others, shape_parameter
from slider_jax.effects.dictionary.flow import WHY_SCALE
from slider_jax.effects.functions import Basis, Powers, mixed_powers, odd_powers

PRESSURE = 20e3
"""Pressure [Pa] that one unit of a term's parameters adds: a tenth of a typical pressure."""


class RearActingPressure:
    """The last chamber; only its acting pressure changes."""

    def act(self, p, memory, dt):
        acting, memory = super().act(p, memory, dt)  # type: ignore[misc]
        return jnp.where(rear_of(p.shape[-1]) == 1.0, acting, p), memory


class ActingPressureTerm(Powers, ActingPressure):
    """p_act = p + f(z). f is a sum of three basis functions of a state z."""

    @abstractmethod
    def of_pressures(self, p: Array) -> Array:
        """Returns the state z of the chambers with the pressures `p` (..., chambers)."""

    @abstractmethod
    def basis(self, z: Array) -> Basis:
        """Returns the basis functions at the state z."""

    def state(self, x: Chamber) -> Array:
        """Returns the state z of the chambers."""
        return self.of_pressures(x.p)

    def act(self, p, memory, dt):
        return p + self.total(self.basis(self.of_pressures(p))), memory


class ActingPressureOfOther(ActingPressureTerm):
    """p_act changes by a function f of p_other, the mean pressure of the other chambers.

    f is a sum of p_other, |p_other| and p_other^2.
    """

    title = "moment of each chamber that depends on the other chambers' pressure"
    term_curve = Curve("pressure of the other chambers", "Pa", "change of the pressure", "Pa")
    scale: Scalar = shape_parameter(200e3, 1e3, 2e6, "Pa", WHY_SCALE)
    """State beyond which the function is constant. A learned function uses the 99.5 % quantile of
    the visited |p|."""

    def of_pressures(self, p):
        return mean_of_others(p)

    def basis(self, z):
        return mixed_powers(z / self.scale, PRESSURE)


class ActingPressureOfDifference(ActingPressureTerm):
    """p_act changes by an odd function f of the difference p - p_other."""

    title = "moment of each chamber that depends on the difference between the pressures"
    term_curve = Curve("difference p - p_other", "Pa", "change of the pressure", "Pa")
    scale: Scalar = shape_parameter(300e3, 1e3, 4e6, "Pa", WHY_SCALE)
    """State beyond which the function is constant. A learned function uses the 99.5 % quantile of
    the visited |p - p_other|."""

    def of_pressures(self, p):
        return p - mean_of_others(p)

    def basis(self, z):
        return odd_powers(z / self.scale, PRESSURE)
