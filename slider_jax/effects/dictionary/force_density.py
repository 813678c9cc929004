"""Terms of the force per length on body and tail."""

from abc import abstractmethod
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from slider_jax.beam.equations import Section
from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Curve, ForceDensity, parameter, shape_parameter
from slider_jax.effects.functions import (
    Basis,
    ChamberPowers,
    LocalDrift,
    PartPowers,
    even_powers,
    magnitude,
    mixed_powers,
    odd_corners,
    odd_powers,
    rises,
    waves,
)

SPEED, ACCELERATION, CURVATURE = 0.5, 10.0, 3.0
"""Lateral speed [m/s], lateral acceleration [m/s^2] and curvature [1/m] in a typical stride (5 Hz).
The parameter of a term with a factor for each part is the force at the term's value of these."""
ROTATION = 10.0
"""Angular velocity [rad/s] of the tail in a typical stride at 5 Hz."""
FORCE = 10.0
"""Force per length [N/m], about the drag of the crossflow at 0.5 m/s with C_d = 3."""
WHY = "the drag of the crossflow at 0.5 m/s is 11 N/m with C_d = 3"
CORNER = 0.1
"""Width of a smooth corner, as a fraction of the scale of the state."""
AXIAL = Curve("lateral velocity u_n", "m/s", "axial force F_tau", "N/m")
VELOCITY = Curve("lateral velocity u_n", "m/s", "normal force F_n", "N/m")


class ForceTerm(ForceDensity):
    """A force per length, either along the axis or normal to it."""

    axial: ClassVar[bool] = False
    """Whether the force is F_tau, along the axis. Otherwise, the force is F_n."""

    @abstractmethod
    def amount(self, x: Section) -> Array:
        """Returns the force per length [N/m] in each cell."""

    def force(self, x):
        F = self.amount(x)
        zero = jnp.zeros_like(F)
        return (F, zero) if self.axial else (zero, F)


class FactorTerm(ForceTerm):
    """A force that is a function of a local state z, with one factor for each part."""

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

    def amount(self, x):
        return (self.body + (self.tail - self.body) * x.in_tail) * self.basis(self.state(x))


class VelocityTerm(PartPowers, ForceTerm):
    """A force that is a function of the lateral velocity u_n in one part of the robot."""

    term_curve = VELOCITY

    scale: Scalar = shape_parameter(SPEED, 1e-3, 100.0, "m/s", "the speeds of a soft robot")
    """State beyond which the function is constant. A learned function uses the 99.5 % quantile of
    the visited |velocity|."""

    def state(self, x: Section) -> Array:
        """Returns u_n in each cell."""
        return x.u_n

    @abstractmethod
    def basis(self, z: Array) -> Basis:
        """Returns the basis functions at the velocity z."""

    def amount(self, x):
        return self.cells(x) * self.total(self.basis(self.state(x)))


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


class NormalForceWithCorners(VelocityTerm):
    """F_n is an odd function of the lateral velocity u_n on the robot that has corners."""

    title = "normal force that depends on the lateral velocity, with corners"
    part = "robot"

    def basis(self, z):
        return odd_corners(z / self.scale, FORCE)


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


def quadratic(u: Array) -> Array:
    """Returns u |u|, with the velocity u in units of `SPEED`."""
    return u * jnp.abs(u) / SPEED**2


class ForceAlongTerm(PartPowers, ForceTerm):
    """A force that is multiplied by a function f of the position s along the robot."""

    part = "robot"
    scale: Scalar = shape_parameter(0.4, 1e-2, 100.0, "m", "the lengths of soft robots")
    """Length of the robot. A learned function uses the 99.5 % quantile of s."""

    def state(self, x: Section) -> Array:
        """Returns the position of each cell."""
        return x.s

    def basis(self, z: Array) -> Basis:
        """Returns the basis functions at the position z. Base parameters describe a constant f."""
        return waves(z / self.scale, FORCE)

    def along(self, x: Section) -> Array:
        """Returns f in each cell."""
        return self.total(self.basis(self.state(x)))


class DragAlongRobot(ForceAlongTerm):
    """F_n = f(s) u_n |u_n|, with the position s along the robot and u_n in units of `SPEED`."""

    title = "drag that varies along the robot"
    term_curve = Curve("position s", "m", "normal force F_n at 0.5 m/s", "N/m")

    def amount(self, x):
        return self.along(x) * quadratic(x.u_n)


class AddedMassAlongRobot(ForceAlongTerm):
    """F_n = f(s) du_n/dt, with the acceleration in units of `ACCELERATION`."""

    title = "added mass that varies along the robot"
    term_curve = Curve("position s", "m", "normal force F_n at 10 m/s^2", "N/m")

    def amount(self, x):
        return self.along(x) * x.u_n_t / ACCELERATION


class DragOfAcceleration(PartPowers, ForceTerm):
    """F_n = f(w) u_n |u_n| with w = sign(u_n) du_n/dt, which is positive while |u_n| grows.

    f is a sum of a smooth sign of w, w, and |w| with a smooth corner. u_n is in units of `SPEED`.
    The corner of the sign of u_n is smooth.
    """

    title = "drag that depends on the acceleration"
    term_curve = Curve("growth of |u_n|", "m/s^2", "normal force F_n at 0.5 m/s", "N/m")
    part = "robot"
    scale: Scalar = shape_parameter(
        ACCELERATION, 1e-2, 1e3, "m/s^2", "a soft robot's accelerations"
    )
    """State beyond which the function is constant. A learned function uses the 99.5 % quantile of
    the visited |w|."""

    def state(self, x: Section) -> Array:
        """Returns w in each cell."""
        return x.u_n_t * x.u_n / magnitude(x.u_n, CORNER * SPEED)

    def basis(self, z: Array) -> Basis:
        """Returns the basis functions at the growth z."""
        return rises(z / self.scale, CORNER, FORCE)

    def amount(self, x):
        return self.total(self.basis(self.state(x))) * quadratic(x.u_n)


class AngleTerm(PartPowers, ForceTerm):
    """A force that depends on the angle phi between the robot's axis and the axis of the tank."""

    part = "robot"
    scale: Scalar = shape_parameter(0.5, 1e-3, 10.0, "rad", "the angles of a soft robot")
    """State beyond which the function is constant. A learned function uses the 99.5 % quantile of
    the visited |phi|."""

    def state(self, x: Section) -> Array:
        """Returns phi in each cell."""
        return x.phi

    def basis(self, z: Array) -> Basis:
        """Returns the basis functions at the angle z."""
        return mixed_powers(z / self.scale, FORCE)

    def of_angle(self, x: Section) -> Array:
        """Returns f in each cell."""
        return self.total(self.basis(self.state(x)))


class DragOfAngle(AngleTerm):
    """F_n = f(phi) u_n |u_n|, with u_n in units of `SPEED`. f is a sum of phi, |phi| and phi^2."""

    title = "drag that depends on the angle of the robot"
    term_curve = Curve("angle phi", "rad", "normal force F_n at 0.5 m/s", "N/m")

    def amount(self, x):
        return self.of_angle(x) * quadratic(x.u_n)


class AddedMassOfAngle(AngleTerm):
    """F_n = f(phi) du_n/dt in units of `ACCELERATION`. f is a sum of phi, |phi| and phi^2."""

    title = "added mass that depends on the angle of the robot"
    term_curve = Curve("angle phi", "rad", "normal force F_n at 10 m/s^2", "N/m")

    def amount(self, x):
        return self.of_angle(x) * x.u_n_t / ACCELERATION


class NormalForceOfAngle(AngleTerm):
    """F_n is an odd function of the angle phi, as a spring or a slow stream causes."""

    title = "normal force that depends on the angle of the robot"
    term_curve = Curve("angle phi", "rad", "normal force F_n", "N/m")

    def basis(self, z):
        return odd_powers(z / self.scale, FORCE)

    def amount(self, x):
        return self.of_angle(x)


class ChamberForceTerm(ChamberPowers, ForceTerm):
    """A force on the body that depends on the pressure p of the chamber.

    f is a sum of p, |p| and p^2.
    """

    def basis(self, z):
        return mixed_powers(z / self.scale, FORCE)


class DragOfPressure(ChamberForceTerm):
    """F_n = f(p) u_n |u_n| on the body, with u_n in units of `SPEED`."""

    title = "drag of the body that depends on the pressure"
    term_curve = Curve("pressure of the chamber", "Pa", "normal force F_n at 0.5 m/s", "N/m")

    def amount(self, x):
        return self.of_pressure(x) * quadratic(x.u_n)


class AddedMassOfPressure(ChamberForceTerm):
    """F_n = f(p) du_n/dt on the body, with the acceleration in units of `ACCELERATION`."""

    title = "added mass of the body that depends on the pressure"
    term_curve = Curve("pressure of the chamber", "Pa", "normal force F_n at 10 m/s^2", "N/m")

    def amount(self, x):
        return self.of_pressure(x) * x.u_n_t / ACCELERATION


class NormalForceOfAxialVelocity(VelocityTerm):
    """F_n = f(u_tau) u_n, with u_n in units of `SPEED`.

    f is a sum of u_tau, |u_tau| and u_tau^2.
    """

    title = "normal force that depends on the axial velocity"
    term_curve = Curve("axial velocity u_tau", "m/s", "normal force F_n at u_n = 0.5 m/s", "N/m")
    part = "robot"

    def state(self, x):
        return x.u_tau

    def basis(self, z):
        return mixed_powers(z / self.scale, FORCE)

    def amount(self, x):
        return super().amount(x) * x.u_n / SPEED


class NormalForceOfAcceleration(FactorTerm):
    """F_n = a du_n/dt, with the acceleration in units of `ACCELERATION`."""

    title = "normal force proportional to the lateral acceleration"
    term_curve = Curve("lateral acceleration du_n/dt", "m/s^2", "normal force F_n", "N/m")

    def state(self, x):
        return x.u_n_t

    def basis(self, z):
        return z / ACCELERATION


class NormalForceOfRotation(FactorTerm):
    """F_n = a |u_n| omega, with u_n in units of `SPEED` and omega in units of `ROTATION`.

    omega is the angular velocity. The force resists or supports the rotation of a section.
    """

    title = "normal force of the rotation"
    term_curve = Curve("|u_n| omega", "m rad/s^2", "normal force F_n", "N/m")

    def state(self, x):
        return jnp.abs(x.u_n) * x.omega

    def basis(self, z):
        return z / (SPEED * ROTATION)


class NormalForceOfCurvature(FactorTerm):
    """F_n = a kappa u_n^2, with kappa in units of `CURVATURE` and u_n in units of `SPEED`."""

    title = "normal force of the flow along a curved body"
    term_curve = Curve("kappa u_n^2", "m/s^2", "normal force F_n", "N/m")

    def state(self, x):
        return x.kappa * x.u_n**2

    def basis(self, z):
        return z / (CURVATURE * SPEED**2)


class AxialForceOnRobot(VelocityTerm):
    """F_tau is an even function of the lateral velocity u_n on the robot.

    The thrust contains only the sum of the axial forces, so the data rarely discriminate between
    separate functions of body and tail.
    """

    title = "axial force on the robot that depends on the lateral velocity"
    term_curve = AXIAL
    axial, part = True, "robot"

    def basis(self, z):
        return even_powers(z / self.scale, FORCE)


class AxialForceOnTail(VelocityTerm):
    """F_tau is an even function of the lateral velocity u_n on the tail."""

    title = "axial force on the tail that depends on the lateral velocity"
    term_curve = AXIAL
    axial, part = True, "tail"

    def basis(self, z):
        return even_powers(z / self.scale, FORCE)


class AxialFriction(VelocityTerm):
    """F_tau is an odd function of the axial velocity u_tau on the robot."""

    title = "axial force that depends on the axial velocity"
    term_curve = Curve("axial velocity u_tau", "m/s", "axial force F_tau", "N/m")
    axial, resists_axially = True, True
    part = "robot"

    def state(self, x):
        return x.u_tau

    def basis(self, z):
        return odd_powers(z / self.scale, FORCE)


class AxialFrictionOfCrossflow(FactorTerm):
    """F_tau = a u_tau |u_n|, with u_tau and u_n in units of `SPEED`."""

    title = "axial friction that grows with the lateral velocity"
    term_curve = Curve("u_tau |u_n|", "m^2/s^2", "axial force F_tau", "N/m")
    axial = resists_axially = True

    def state(self, x):
        return x.u_tau * jnp.abs(x.u_n)

    def basis(self, z):
        return z / SPEED**2


class DragDrift(LocalDrift, ForceTerm):
    """F_n = F f(t) u_n |u_n| with F = 10 N/m. u_n has the unit `SPEED`."""

    title = "drag that drifts during a trial"
    term_curve = Curve("time t", "s", "change of F_n at 0.5 m/s, divided by 10 N/m", "-")
    part = "robot"

    def amount(self, x):
        return FORCE * self.in_cells(x) * quadratic(x.u_n)
