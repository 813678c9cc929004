"""Terms of the force per length on body and tail."""

from abc import abstractmethod

import jax.numpy as jnp
from jaxtyping import Array

from slider_jax.beam.equations import Section
from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Curve, ForceDensity, parameter, shape_parameter
from slider_jax.effects.functions import Basis, PartPowers, Powers, even_powers, odd_powers, waves

SPEED, ACCELERATION, CURVATURE = 0.5, 10.0, 3.0
"""Lateral speed [m/s], lateral acceleration [m/s^2] and curvature [1/m] in a typical stride (5 Hz).
The parameter of a term with a factor for each part is the force at the term's value of these."""
FORCE = 10.0
"""Force per length [N/m], about the drag of the crossflow at 0.5 m/s with C_d = 3."""
WHY = "the drag of the crossflow at 0.5 m/s is 11 N/m with C_d = 3"
VELOCITY = Curve("lateral velocity u_n", "m/s", "normal force F_n", "N/m")


class ForceTerm(ForceDensity):
    """A force per length that is a function of a local state z, with one factor for each part."""

    body: Scalar = parameter(0.0, -20.0, 20.0, "N/m", WHY)
    """Factor on the body."""
    tail: Scalar = parameter(0.0, -20.0, 20.0, "N/m", WHY)
    """Factor on the tail."""

    @abstractmethod
    def state(self, x: Section) -> Array:
        """Returns the state z in each cell."""

    @abstractmethod
    def basis(self, z: Array) -> Array:
        """Returns the function at the state z for a factor of 1."""

    @abstractmethod
    def direction(self) -> tuple[float, float]:
        """Returns the direction (tau, n) of the force."""

    def force(self, x):
        F = (self.body + (self.tail - self.body) * x.in_tail) * self.basis(self.state(x))
        tau, n = self.direction()
        return tau * F, n * F


class VelocityTerm(PartPowers, ForceDensity):
    """F_n [N/m] is a function of the lateral velocity u_n in one part of the robot."""

    term_curve = VELOCITY

    scale: Scalar = shape_parameter(SPEED, 1e-3, 100.0, "m/s", "the speeds of a soft robot")
    """State beyond which the function is constant. A learned function uses the 99.5 % quantile of
    the visited |u_n|."""

    def state(self, x: Section) -> Array:
        """Returns u_n in each cell."""
        return x.u_n

    @abstractmethod
    def basis(self, z: Array) -> Basis:
        """Returns the basis functions at the lateral velocity z."""

    def force(self, x):
        F = self.cells(x) * self.total(self.basis(self.state(x)))
        return jnp.zeros_like(F), F


class NormalForceOnBody(VelocityTerm):
    """F_n is an odd function of the lateral velocity u_n on the body."""

    title = "normal force on the body that depends on the lateral velocity"

    def basis(self, z):
        return odd_powers(z / self.scale, FORCE)


class NormalForceOnTail(VelocityTerm):
    """F_n is an odd function of the lateral velocity u_n on the tail."""

    title = "normal force on the tail that depends on the lateral velocity"

    part = "tail"

    def basis(self, z):
        return odd_powers(z / self.scale, FORCE)


class NormalForceOnBodyBySide(VelocityTerm):
    """F_n is an even function of u_n on the body, so the robot's sides differ."""

    title = "normal force on the body that differs between the sides"

    def basis(self, z):
        return even_powers(z / self.scale, FORCE)


class NormalForceOnTailBySide(VelocityTerm):
    """F_n is an even function of u_n on the tail, so the robot's sides differ."""

    title = "normal force on the tail that differs between the sides"

    part = "tail"

    def basis(self, z):
        return even_powers(z / self.scale, FORCE)


class DragAlongRobot(Powers, ForceDensity):
    """F_n = f(s) u_n |u_n|, with the position s along the robot and u_n in units of `SPEED`."""

    title = "drag that varies along the robot"
    term_curve = Curve("position s", "m", "normal force F_n at 0.5 m/s", "N/m")

    scale: Scalar = shape_parameter(0.4, 1e-2, 100.0, "m", "the lengths of soft robots")
    """Length of the robot. A learned function uses the 99.5 % quantile of s."""

    def cells(self, x: Section) -> Array:
        """Returns 1 in each cell."""
        return jnp.ones_like(x.s)

    def state(self, x: Section) -> Array:
        """Returns the position of each cell."""
        return x.s

    def basis(self, z: Array) -> Basis:
        """Returns the basis functions at the position z; C_d describes a constant f."""
        return waves(z / self.scale, FORCE)

    def force(self, x):
        u = x.u_n / SPEED
        F = self.total(self.basis(self.state(x))) * u * jnp.abs(u)
        return jnp.zeros_like(F), F


class NormalForceOfAcceleration(ForceTerm):
    """F_n = a du_n/dt, with the acceleration in units of `ACCELERATION`."""

    title = "normal force proportional to the lateral acceleration"
    term_curve = Curve("lateral acceleration du_n/dt", "m/s^2", "normal force F_n", "N/m")

    def state(self, x):
        return x.u_n_t

    def basis(self, z):
        return z / ACCELERATION

    def direction(self):
        return 0.0, 1.0


class NormalForceOfCurvature(ForceTerm):
    """F_n = a kappa u_n^2, with kappa in units of `CURVATURE` and u_n in units of `SPEED`."""

    title = "normal force of the flow along a curved body"
    term_curve = Curve("kappa u_n^2", "m/s^2", "normal force F_n", "N/m")

    def state(self, x):
        return x.kappa * x.u_n**2

    def basis(self, z):
        return z / (CURVATURE * SPEED**2)

    def direction(self):
        return 0.0, 1.0


class AxialForceQuadratic(ForceTerm):
    """F_tau = a u_n^2, with the lateral velocity in units of `SPEED`."""

    title = "axial force quadratic in the lateral velocity"
    term_curve = Curve("lateral velocity u_n", "m/s", "axial force F_tau", "N/m")

    def state(self, x):
        return x.u_n

    def basis(self, z):
        return (z / SPEED) ** 2

    def direction(self):
        return 1.0, 0.0
