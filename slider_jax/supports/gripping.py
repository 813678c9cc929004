"""Support of a robot that swims to a wall and climbs it: a cross-link whose ends grip by spines."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.clock import Clock
from slider_jax.beam.parameters import Scalar
from slider_jax.beam.state import Fields, to_body, to_plane
from slider_jax.supports.base import Start
from slider_jax.supports.free import MovingHead

ROUNDING = 0.01
"""The limit of friction is rounded over this fraction of the limit, so that the force has a
continuous derivative. A grip creeps until its force is below (1 - `ROUNDING`) times the limit."""
BLEND = 0.5
"""Weight of the velocity in the choice between stick and slip. With 1, Newton's method may
alternate between slips to both sides when a fast end grips. With 0.05, steps in full slip failed.
From 0.5 to 0.7, no step failed with 2 to 30 N s/m, 4 to 20 kN/m and limits of 2.5 to 10 N."""
FREE, HOLDING, LOST = 0.0, 1.0, 2.0


class Spines(eqx.Module):
    """The microspines at one end of the cross-link: a spring and a dashpot behind dry friction.

        F = k z + c dz/dt,    |F| <= F_max = mu N,    dx/dt = dz/dt + slip,    slip parallel to F

    x is the place of the end relative to the wall, z the stretch of the spines and F their force on
    the wall. Below F_max, the spines stick. At F_max, the grip point follows the end. The grip is
    lost if |F| exceeds the pull-off force F_p at the end of a time step. With F_p < F_max, the
    spines break off without slip; with the default values, they slip and never break off. The
    friction limit is rounded over 1 %, so that F has a continuous derivative.

    Sources: Asbeck, A. T., Kim, S., Cutkosky, M. R., Provancher, W. R. and Lanzetta, M. (2006),
    Scaling hard vertical surfaces with compliant microspine arrays, Int. J. Robotics Research 25,
    1165-1179 (a spine holds of the order of 1 N, and compliance shares the load between the
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
    """F_p [N], force at which the spines or the asperities break off: assumed 1.5 N per spine."""

    @property
    def limit(self) -> Scalar:
        """Largest force F_max [N] along the wall."""
        return self.friction * self.preload

    def after(
        self,
        stretch: Float[Array, "2"],
        velocity: Float[Array, "2"],
        dt: Array,
        given: Float[Array, "2"] | None = None,
    ) -> tuple[Float[Array, "2"], Float[Array, "2"]]:
        """Returns the force (2,) [N] on the wall and the stretch (2,) [m] at the end of a stage.

        `stretch` [m] is the reference of the stage `dt` [s], and `velocity` [m/s] the velocity of
        the end. The work on the spines is at least the energy k z^2/2 that they gain, exactly.

        With `given`, an unknown force [N] that equals the returned force F in the solution, the law
        decides between stick and slip also by this force, as in an active-set method (see `BLEND`).
        The solution is the same, except that the rounding of the limit is wider.
        """
        rate = self.damping / dt
        trial = (self.stiffness + rate) * (stretch + dt * velocity) - rate * stretch
        if given is not None:
            trial = given + BLEND * (trial - given)
        square = jnp.sum(trial**2)
        inside = square < ((1.0 - ROUNDING) * self.limit) ** 2
        size = jnp.sqrt(jnp.where(inside, 1.0, square))
        excess = size - (1.0 - ROUNDING) * self.limit
        rounded = size - excess**2 / (4.0 * ROUNDING * self.limit)
        most = jnp.where(excess < 2.0 * ROUNDING * self.limit, rounded, self.limit)
        force = trial * jnp.where(inside, 1.0, most / size)
        if given is not None:
            return force, (given + rate * stretch) / (self.stiffness + rate)
        return force, (force + rate * stretch) / (self.stiffness + rate)


class GripState(eqx.Module):
    """The grips of the left and the right end of the cross-link."""

    stretch: Float[Array, "ends 2"]
    """Stretch z (x, y) [m] of the spines."""
    status: Float[Array, " ends"]
    """`FREE`, `HOLDING` or `LOST`; constant within a time step."""
    load: Float[Array, " ends"]
    """Size [N] of the spines' force at the end of the stage."""


class GrippingLink(MovingHead):
    """A massless rigid link across the head whose two ends grip a wall by `spines`, in turn.

    The wall covers the plane of motion above the height `wall_from` along the direction `up`. In
    the first half of each period of the `clock`, delayed by `phase`, the left end is commanded to
    grip, and then the right end. An end grips if it is commanded to and lies on the wall. It is
    released at the end of its command. If its grip is lost, it grips again at its next command
    only. Without a grip, the head is free. With the vector r_i from the head to the holding end i
    and the force R_i = -F_i of the wall on this end,

        T tau + N n = R_i,    M = r_i x R_i

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

    def _held(self, head: Fields, omega: Array) -> tuple[Array, Array, Array, Array]:
        """Returns arm [m], force on the wall by the law, force on the wall by the head, stretch."""
        held = self.held
        assert held is not None
        holds = (held.status == HOLDING).astype(float)
        arm = jnp.sum(holds * self.arms())
        velocity = jnp.stack(to_plane(head.V_tau - arm * omega, head.V_n, head.phi))
        given = -jnp.stack(to_plane(head.T, head.N, head.phi))
        dt = jnp.asarray(self.dt, float)
        law, stretch = self.spines.after(holds @ held.stretch, velocity, dt, given)
        on = jnp.sum(holds) > 0.0
        return arm, jnp.where(on, law, 0.0), given, jnp.where(on, stretch, 0.0)

    def grips(self, head: Fields, omega: Array) -> tuple[Array, GripState]:
        """Returns the forces (ends, 2) [N] on the head's link in the plane, and the new grips."""
        _, law, _, stretch = self._held(head, omega)
        held = self.held
        assert held is not None
        holds = held.status == HOLDING
        holding = jnp.any(holds)
        size = jnp.sqrt(jnp.sum(jnp.where(holding, law, 1.0) ** 2))
        each = holds[:, None]
        after = GripState(
            jnp.where(each, stretch, 0.0), held.status, jnp.where(holds & holding, size, 0.0)
        )
        return jnp.where(each, -law, 0.0), after

    def settled(self, head, omega, t):
        return self.grips(head, omega)[1]

    def rows(self, head, omega, t):
        arm, law, given, _ = self._held(head, omega)
        tau, n = to_body(law - given, head.phi)
        return tau, n, head.M + arm * head.T

    def start(self, t):
        heading = jnp.asarray(self.heading, float)
        return Start(to_plane(self.speed, 0.0, heading), heading, jnp.zeros(()))

    def rows_in_space(self, head, frame, omega, t):
        raise NotImplementedError("GrippingLink is defined in the plane only")

    def anchor_in_space(self, t):
        raise NotImplementedError("GrippingLink is defined in the plane only")
