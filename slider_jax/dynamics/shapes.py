"""Prescribes the curvature of the cells in which `PrescribedShape` actuators act.

The rate of the curvature is prescribed, and not the curvature. Let w = d(kappa_p)/dt. The stages of
a step that starts at t_0 prescribe the rates that the time scheme itself gives for w(t_0) and the
exact dw/dt. The curvature, and the forces that are linear in the motion, then have the order of the
scheme. The axial forces of inertia are quadratic in the motion and have an error of first order, as
at a clamp. With the exact rates w at the stages, all forces would be of first order.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from slider_jax.actuation import Actuator, PrescribedShape
from slider_jax.beam.equations import Structure
from slider_jax.dynamics.time_schemes import Scheme


class Shape(eqx.Module):
    """The cells with a prescribed curvature, and its rate. Stages may be the first axis."""

    cells: Bool[Array, " *b cells"]
    rate: Float[Array, " *b cells"]
    """d(kappa)/dt [1/(m s)]."""


def _curvature(actuators: tuple[Actuator, ...], body: Structure):
    """Returns the cells with a prescribed curvature, and a function of t that returns kappa_p."""
    shapes = [x for x in actuators if isinstance(x, PrescribedShape)]
    places = [x.place(body.s, body.ds) for x in shapes]

    def at(t):
        kappa = jnp.zeros_like(body.s)
        for actuator, (distance, share) in zip(shapes, places, strict=True):
            kappa = jnp.where(share > 0.5, actuator.curvature(distance, t), kappa)
        return kappa

    cells = jnp.any(jnp.stack([share > 0.5 for _, share in places]), axis=0)
    return cells, at


def has_shape(actuators: tuple[Actuator, ...]) -> bool:
    """Returns whether one of the actuators is a `PrescribedShape`."""
    return any(isinstance(x, PrescribedShape) for x in actuators)


def shape_at(actuators: tuple[Actuator, ...], body: Structure, t) -> tuple[Shape, Array]:
    """Returns the shape with its exact rate, and the curvature (cells,) [1/m], at `t` [s]."""
    cells, at = _curvature(actuators, body)
    kappa, rate = jax.jvp(at, (t,), (jnp.ones_like(t),))
    return Shape(cells, rate), kappa


def shape_in_step(
    actuators: tuple[Actuator, ...], body: Structure, scheme: Scheme, t0, h
) -> Shape | None:
    """Returns the shape in all stages of a step of `h` [s] from `t0` [s]; None without shapes."""
    if not has_shape(actuators):
        return None
    cells, at = _curvature(actuators, body)

    def rate(t):
        return jax.jvp(at, (t,), (jnp.ones_like(t),))[1]

    base = last = rate(t0)
    rates = []
    for node, weight in zip(scheme.nodes, scheme.weights, strict=True):
        t = t0 + node * h
        change = jax.jvp(rate, (t,), (jnp.ones_like(t),))[1]
        last = base + weight * (last - base) + scheme.gamma * h * change
        rates.append(last)
    return Shape(jnp.broadcast_to(cells, (scheme.stages, *cells.shape)), jnp.stack(rates))
