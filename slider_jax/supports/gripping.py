"""Support of a robot that swims to a wall and climbs it: a cross-link whose ends grip by spines."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.clock import Clock
from slider_jax.beam.parameters import Scalar
from slider_jax.beam.state import Fields, to_body, to_plane
from slider_jax.supports.base import Start, Support

ROUNDING = 0.01
"""The limit of friction is rounded over this fraction of the limit, so that the force has a
continuous derivative. A grip creeps until its force is below (1 - `ROUNDING`) times the limit."""
FREE, HOLDING, LOST = 0.0, 1.0, 2.0


class Spines(eqx.Module):
    """The microspines at one end of the cross-link: a spring and a dashpot behind dry friction.

        F = k z + c dz/dt,    |F| <= F_max = mu N,    dx/dt = dz/dt + slip,    slip parallel to F

    x is the place of the end relative to the wall, z the stretch of the spines and F their force on
    the wall. Below F_max, the spines stick. At F_max, the grip point follows the end. The grip is
    lost if |F| exceeds the pull-off force F_p at the end of a time step. With F_p < F_max, the
    spines break off without slip. The friction limit is rounded over 1 %.

    Sources: Asbeck, A. T., Kim, S., Cutkosky, M. R., Provancher, W. R. and Lanzetta, M. (2006),
    Scaling hard vertical surfaces with compliant microspine arrays, Int. J. Robotics Research 25,
    1165-1179 (a spine holds 1 to 2 N on rough walls, and compliance shares the load between the
    spines); Dupont, P., Hayward, V., Armstrong, B. and Altpeter, F. (2002), Single state
    elastoplastic friction models, IEEE Trans. Autom. Control 47, 787-792 (a purely elastic range).
    The default values are assumed for ten spines at each end.
    """

    stiffness: Scalar = 4000.0
    """k [N/m] along the wall: the robot's weight of 2.5 N stretches the spines by 0.6 mm."""
    damping: Scalar = 8.0
    """c [N s/m]: k/c = 500 1/s, so a grip settles in a few milliseconds."""
    friction: Scalar = 2.0
    """mu [-], largest force along the wall divided by the preload; hooks exceed dry friction."""
    preload: Scalar = 5.0
    """N [N], force that presses the spines of an end into the wall."""
    pull_off: Scalar = 15.0
    """F_p [N], force at which the spines or the asperities break off: 1.5 N for each spine."""

    @property
    def limit(self) -> Scalar:
        """Largest force F_max [N] along the wall."""
        return self.friction * self.preload

    def after(
        self, stretch: Float[Array, "2"], velocity: Float[Array, "2"], dt: Array
    ) -> tuple[Float[Array, "2"], Float[Array, "2"]]:
        """Returns the force (2,) [N] on the wall and the stretch (2,) [m] at the end of a stage.

        `stretch` [m] is the reference of the stage `dt` [s], and `velocity` [m/s] the velocity of
        the end. The work on the spines is at least the energy k z^2/2 that they gain, exactly.
        """
        rate = self.damping / dt
        trial = (self.stiffness + rate) * (stretch + dt * velocity) - rate * stretch
        square = jnp.sum(trial**2)
        inside = square < ((1.0 - ROUNDING) * self.limit) ** 2
        size = jnp.sqrt(jnp.where(inside, 1.0, square))
        excess = size - (1.0 - ROUNDING) * self.limit
        rounded = size - excess**2 / (4.0 * ROUNDING * self.limit)
        most = jnp.where(excess < 2.0 * ROUNDING * self.limit, rounded, self.limit)
        force = trial * jnp.where(inside, 1.0, most / size)
        return force, (force + rate * stretch) / (self.stiffness + rate)


class GripState(eqx.Module):
    """The grips of the left and the right end of the cross-link."""

    stretch: Float[Array, "ends 2"]
    """Stretch z (x, y) [m] of the spines."""
    status: Float[Array, " ends"]
    """`FREE`, `HOLDING` or `LOST`; constant within a time step."""
    load: Float[Array, " ends"]
    """Size [N] of the spines' force at the end of the stage."""


class GrippingLink(Support):
    """A massless rigid link across the head whose two ends grip a wall by `spines`, in turn.

    The wall covers the plane of motion above the height `wall_from` along the direction `up`. In
    the first half of each period of the `clock`, delayed by `phase`, the left end is commanded to
    grip, and then the right end. An end grips if it is commanded to and lies on the wall. It is
    released at the end of its command. If its grip is lost, it grips again at its next command
    only. Without a grip, the head is free. With r_i the vector from the head to end i,

        T tau + N n = F_left + F_right,    M = r_left x F_left + r_right x F_right

    Grips begin and end between time steps. Derivatives do not include the change of these steps,
    and the position of an end changes its force only through the step in which it grips.
    """

    spines: Spines
    clock: Clock
    link_length: Scalar = 0.03
    phase: Scalar | Float[Array, " knots"] = 0.0
    """Delay as a fraction of a period: one number, or its values at the clock's times."""
    wall_from: Scalar = 0.0
    up: Scalar = 0.0
    speed: Scalar = 0.0
    """Speed [m/s] at the start, along the body."""
    heading: Scalar = 0.0
    """Angle [rad] of the straight body to the x axis at the start."""
    held: GripState | None = None
    """Reference of the grips in a stage; None between the stages."""
    dt: Scalar = 1.0

    def arms(self) -> Float[Array, "2"]:
        """Returns the positions [m] of the left and the right end along n."""
        half = 0.5 * jnp.asarray(self.link_length, float)
        return jnp.stack([half, -half])

    def ends(self, head: Float[Array, "2"], phi: Array) -> Float[Array, "ends 2"]:
        """Returns the places (x, y) [m] of the ends."""
        n = jnp.stack(to_plane(0.0, 1.0, phi))
        return head + self.arms()[:, None] * n

    def commanded(self, t: Array) -> Float[Array, "2"]:
        """Returns 1 for the end that is commanded to grip at `t` [s], and 0 for the other end."""
        phase = jnp.asarray(self.phase, float)
        if phase.ndim:
            phase = jnp.interp(t, jnp.asarray(self.clock.times, float), phase)
        turn = self.clock.turns(t) - phase
        left = turn - jnp.floor(turn) < 0.5
        return jnp.where(jnp.array([True, False]), left, ~left).astype(float)

    def start_state(self):
        return GripState(jnp.zeros((2, 2)), jnp.full(2, FREE), jnp.zeros(2))

    def begin(self, state, head, phi, t0, t1):
        asked = self.commanded(0.5 * (t0 + t1)) > 0.5
        up = jnp.stack(to_plane(1.0, 0.0, jnp.asarray(self.up, float)))
        on_wall = self.ends(head, phi) @ up >= self.wall_from
        holds = state.status == HOLDING
        lost = (state.status == LOST) | (holds & (state.load > self.spines.pull_off))
        kept = jnp.where(lost, LOST, jnp.where(holds | on_wall, HOLDING, FREE))
        status = jnp.where(asked, kept, FREE)
        stays = (status == HOLDING) & holds
        stretch = jnp.where(stays[:, None], state.stretch, 0.0)
        return GripState(stretch, status, jnp.where(stays, state.load, 0.0))

    def in_stage(self, state, dt):
        return eqx.tree_at(
            lambda x: (x.held, x.dt), self, (state, jnp.asarray(dt)), is_leaf=lambda x: x is None
        )

    def grips(self, head: Fields, omega: Array) -> tuple[Array, GripState]:
        """Returns the forces (ends, 2) [N] on the head's link in the plane, and the new grips."""
        held = self.held
        assert held is not None
        forces, stretches = [], []
        for arm, stretch in zip(self.arms(), held.stretch, strict=True):
            velocity = to_plane(head.V_tau - arm * omega, head.V_n, head.phi)
            force, moved = self.spines.after(stretch, jnp.stack(velocity), self.dt)
            forces.append(force)
            stretches.append(moved)
        holds = (held.status == HOLDING)[:, None]
        force = jnp.where(holds, jnp.stack(forces), 0.0)
        size = jnp.sqrt(jnp.sum(jnp.where(holds, force, 1.0) ** 2, axis=1))
        load = jnp.where(holds[:, 0], size, 0.0)
        return -force, GripState(jnp.where(holds, jnp.stack(stretches), 0.0), held.status, load)

    def settled(self, head, omega, t):
        return self.grips(head, omega)[1]

    def rows(self, head, omega, t):
        forces, _ = self.grips(head, omega)
        tau, n = to_body(forces.T, head.phi)
        moment = jnp.sum(-self.arms() * tau)
        return head.T - jnp.sum(tau), head.N - jnp.sum(n), head.M - moment

    def start(self, t):
        heading = jnp.asarray(self.heading, float)
        return Start(to_plane(self.speed, 0.0, heading), heading, jnp.zeros(()))

    def during(self, t0, t1):
        return self

    def sensor_angle(self, phi, t):
        return phi

    def anchor_offset(self, phi, t):
        return jnp.zeros(2)

    def anchor_velocity(self, head, omega, t):
        return jnp.stack(to_plane(head.V_tau, head.V_n, head.phi))

    def rows_in_space(self, head, frame, omega, t):
        raise NotImplementedError("GrippingLink is defined in the plane only")

    def anchor_in_space(self, t):
        raise NotImplementedError("GrippingLink is defined in the plane only")
