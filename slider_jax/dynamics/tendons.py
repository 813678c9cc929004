"""Loads of the actuators on the cells: tensions of tendons, and couples.

The tension of an elastic tendon depends on the strain and the curvature in its whole span. The
Jacobian is then a matrix of blocks for constant tensions, plus one product of a column and a row
for each tendon. `BeamOperator` contains both parts.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.actuation import Actuator, Couple, Tendon
from slider_jax.beam.equations import Reference, Section, Structure, strain
from slider_jax.beam.state import Fields


def tendons_of(actuators: tuple[Actuator, ...]) -> tuple[Tendon, ...]:
    """Returns the tendons among the actuators."""
    return tuple(x for x in actuators if isinstance(x, Tendon))


def tensions(
    actuators: tuple[Actuator, ...],
    mid: Fields,
    slope: Fields,
    body: Structure,
    reference: Reference,
    t: Array,
) -> Float[Array, " tendons"]:
    """Returns the tensions [N] of the tendons.

    The tendons compress the body, so the elongations depend linearly on the tensions P. The
    equations P = tension(elongation(P)) are solved by Newton's method in each evaluation. They are
    piecewise linear with a unique solution, and the method finds the set of slack tendons first.
    """
    tendons = tendons_of(actuators)

    def tension(elongations):
        return jnp.stack(
            [jnp.asarray(x.tension(c, t), float) for x, c in zip(tendons, elongations, strict=True)]
        )

    places = [tendon.place(body.s, body.ds) for tendon in tendons]
    spans = jnp.stack([share * body.ds for _, share in places])
    offsets = jnp.stack([x.offset_at(at) for x, (at, _) in zip(tendons, places, strict=True)])
    free = spans @ strain(mid.T, body, reference) - jnp.sum(spans * offsets * slope.phi, axis=1)
    if not any(tendon.elastic for tendon in tendons):
        return tension(free)
    # A unit of T gives this strain; the tensions give the opposite.
    soft = strain(jnp.ones_like(mid.T), body, replace(reference, strain=0.0 * mid.T))
    compliance = (spans * soft) @ (spans / body.ds).T

    def newton(P, free, compliance):
        lengths = free - compliance @ P
        value, slope = jax.jvp(tension, (lengths,), (jnp.ones_like(P),))
        matrix = jnp.eye(len(tendons), dtype=P.dtype) + slope[:, None] * compliance
        return P - jnp.linalg.solve(matrix, P - value)

    fixed = jax.lax.stop_gradient((free, compliance))
    P = jnp.zeros_like(free)
    for _ in range(len(tendons) + 1):
        P = jax.lax.stop_gradient(newton(P, *fixed))
    # The last step has the derivative of the solution.
    return newton(P, free, compliance)


def tendon_loads(
    actuators: tuple[Actuator, ...], tension: Float[Array, " tendons"], body: Structure
) -> tuple[Array, Array]:
    """Returns the active moment [N m] and the axial compression [N] (cells,) of the tendons."""
    moment = compression = jnp.zeros_like(body.s)
    for P, tendon in zip(tension, tendons_of(actuators), strict=True):
        distance, share = tendon.place(body.s, body.ds)
        moment = moment + P * share * tendon.offset_at(distance)
        compression = compression + P * share
    return moment, compression


def couples(actuators: tuple[Actuator, ...], x: Section) -> Array:
    """Returns the active moment [N m] (cells,) of the `Couple` actuators."""
    parts = [actuator.moment(x) for actuator in actuators if isinstance(actuator, Couple)]
    return sum(parts, jnp.zeros_like(x.kappa))
