"""Terms of the force per length on body and tail."""

from abc import abstractmethod

import jax.numpy as jnp
from jaxtyping import Array

from slider_jax.beam.equations import Section
from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Curve, ForceDensity, parameter
from slider_jax.effects.functions import magnitude

SPEED, ACCELERATION, CURVATURE = 0.5, 10.0, 3.0
"""Lateral speed [m/s], lateral acceleration [m/s^2] and curvature [1/m] in a typical stride (5 Hz).
The parameter of a term is the force at the term's value of these three."""
CORNER = 0.02
"""Width [m/s] of the smooth corner of a one-sided function."""
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


class NormalForceTerm(ForceTerm):
    """A force along n that is a function of the lateral velocity u_n."""

    def state(self, x):
        return x.u_n

    def direction(self):
        return 0.0, 1.0


class NormalForceLinear(NormalForceTerm):
    """F_n = a u, with the lateral velocity u in units of `SPEED`."""

    title = "normal force linear in the lateral velocity"
    term_curve = VELOCITY

    def basis(self, z):
        return z / SPEED


class NormalForceQuadratic(NormalForceTerm):
    """F_n = a u |u|, with the lateral velocity u in units of `SPEED`."""

    title = "normal force quadratic in the lateral velocity"
    term_curve = VELOCITY

    def basis(self, z):
        return z * jnp.abs(z) / SPEED**2


class NormalForceCubic(NormalForceTerm):
    """F_n = a u^3, with the lateral velocity u in units of `SPEED`."""

    title = "normal force cubic in the lateral velocity"
    term_curve = VELOCITY

    def basis(self, z):
        return (z / SPEED) ** 3


class NormalForceOneSided(NormalForceTerm):
    """F_n = a max(u, 0), with the lateral velocity u in units of `SPEED`."""

    title = "normal force on one side"
    term_curve = VELOCITY

    def basis(self, z):
        return 0.5 * (z + magnitude(z, CORNER) - CORNER) / SPEED


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
