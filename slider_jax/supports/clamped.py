"""Support of a head that is clamped to a carriage, which may move forward, heave and pitch."""

import math

import equinox as eqx
import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.beam.spatial import Vec
from slider_jax.beam.state import to_body, to_plane
from slider_jax.supports.base import Start, Support


class Clamped(Support):
    """A clamp that prescribes V_tau, V_n and the turning rate of the head.

    The carriage moves along x at `tow_speed` [m/s]. The carriage may also heave along y and pitch:

        y_h = heave sin(2 pi f t),    phi_h = pitch sin(2 pi f t + pitch_phase)

    y_h [m] and phi_h [rad] are the carriage's position and angle, with `heave` [m], `pitch` [rad],
    f = `frequency` [Hz] and `pitch_phase` [rad]. The clamp prescribes the rate d(phi_h)/dt, not the
    angle phi_h. With a prescribed angle, the error of the turning rate and of the clamp forces
    would be of first order in the time step.
    """

    tow_speed: Scalar = eqx.field(default=0.0)
    heave: Scalar = eqx.field(default=0.0)
    pitch: Scalar = eqx.field(default=0.0)
    frequency: Scalar = eqx.field(default=0.0)
    pitch_phase: Scalar = eqx.field(default=0.0)

    def carriage(self, t):
        """Returns velocity (x, y) [m/s], angle [rad] and turning rate [rad/s] of the carriage."""
        turn = 2.0 * math.pi * self.frequency
        velocity = (jnp.asarray(self.tow_speed), self.heave * turn * jnp.cos(turn * t))
        phase = turn * t + self.pitch_phase
        return velocity, self.pitch * jnp.sin(phase), self.pitch * turn * jnp.cos(phase)

    def rows(self, head, omega, t):
        velocity, _, rate = self.carriage(t)
        V_tau, V_n = to_body(velocity, head.phi)
        return head.V_tau - V_tau, head.V_n - V_n, omega - rate

    def start(self, t):
        return Start(*self.carriage(t))

    def during(self, t0, t1):
        return self

    def sensor_angle(self, phi, t):
        return self.carriage(t)[1]

    def anchor_offset(self, phi, t):
        return jnp.zeros(2)

    def anchor_velocity(self, head, omega, t):
        return jnp.stack(to_plane(head.V_tau, head.V_n, head.phi))

    def rows_in_space(self, head, frame, omega, t):
        velocity, _, rate = self.carriage(t)
        zero = jnp.zeros_like(rate)
        moved = frame.to_frame(jnp.stack([*velocity, zero]))
        turned = frame.to_frame(jnp.stack([zero, zero, rate]))
        return *head.V.minus(moved), *omega.minus(turned)

    def anchor_in_space(self, t):
        return Vec(*jnp.zeros(3))
