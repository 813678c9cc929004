"""Computes the forces of the robot model's effects on an animal whose motion is prescribed.

The motion is converted to a `Section`, the state of a cell from which an effect computes a force.
Animal and robot thus use the same code of the effects. Depth and mass vary along the animal.
"""

import math
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from calibration.lamprey.motion import Motion
from slider_jax.beam.equations import Reference, Section, Structure, section
from slider_jax.beam.state import Fields, to_body, to_plane
from slider_jax.effects import ForceDensity

VISCOSITY = 1.0e-6
"""Kinematic viscosity [m^2/s] of water at 20 degrees Celsius."""
SNOUT_SHARE = 0.04
"""Length of the snout, divided by the body length. The outline of the snout is an ellipse."""
FIN_START = 0.6
"""Position where the fins begin, in body lengths from the snout. The fins end at the tail's end."""


@dataclass(frozen=True, eq=False)
class CrossSections:
    """The cross-sections of the animal: ellipses of the measured width and an assumed depth.

    In front of the fins, the depth is `aspect` times the width. Along the fins, the depth changes
    linearly to `tail_depth` [body lengths] at the tail's end. The tail's end is not rounded.
    """

    positions: np.ndarray
    """Positions (n,) of the widths, from 0 at the snout to 1 at the tail."""
    width: np.ndarray
    """Full width (n,), in body lengths."""
    aspect: float = 1.5
    tail_depth: float = 0.04
    density: float = 1040.0
    """Density of the animal [kg/m^3]."""

    def with_depth(self, aspect: float, tail_depth: float) -> "CrossSections":
        """Returns cross-sections with the width of these cross-sections and another depth."""
        return replace(self, aspect=aspect, tail_depth=tail_depth)

    def at(self, from_snout: np.ndarray, length: float) -> tuple[np.ndarray, np.ndarray]:
        """Returns width and depth [m] at positions `from_snout`, from 0 (snout) to 1 (tail)."""
        width = np.interp(from_snout, self.positions, self.width)
        before = (
            np.interp(np.minimum(from_snout, FIN_START), self.positions, self.width) * self.aspect
        )
        along = np.clip((from_snout - FIN_START) / (1.0 - FIN_START), 0.0, 1.0)
        depth = before + along * (self.tail_depth - before)
        inside = np.clip(from_snout / SNOUT_SHARE, 0.0, 1.0)
        rounded = np.sqrt(inside * (2.0 - inside))
        return width * rounded * length, depth * rounded * length


class AnimalBody(eqx.Module):
    """Cross-sections of the animal in the cells between the nodes. They do not change in time."""

    structure: Structure
    width: Float[Array, " cells"]
    """Width [m] of the cross-sections."""

    @property
    def mass(self) -> float:
        """Mass [kg] of the animal."""
        return float(jnp.sum(self.structure.linear_density * self.structure.ds))

    @property
    def perimeter(self) -> Float[Array, " cells"]:
        """Perimeter [m] of the elliptic cross-sections, by Ramanujan's approximation."""
        a, b = 0.5 * self.width, 0.5 * self.structure.height
        return math.pi * (3.0 * (a + b) - jnp.sqrt((3.0 * a + b) * (a + 3.0 * b)))


def body_on_nodes(shape: CrossSections, s: np.ndarray) -> AnimalBody:
    """Returns the cross-sections between nodes at distances `s` [m] from the tail."""
    ends, middle, ds = 1.0 - s / s[-1], 1.0 - 0.5 * (s[1:] + s[:-1]) / s[-1], np.diff(s)
    width, depth = shape.at(middle, s[-1])
    _, at_nodes = shape.at(ends, s[-1])
    # The added mass is proportional to the squared depth. With this slope of the depth, the
    # momentum that leaves a cell equals the momentum that enters the next cell.
    slope = np.diff(at_nodes**2) / (2.0 * depth * ds)
    one = np.ones_like(middle)
    structure = Structure(
        linear_density=shape.density * math.pi / 4.0 * width * depth,
        EI=one,
        EA=one,
        damping_time=0.0 * one,
        height=jnp.asarray(depth),
        height_s=jnp.asarray(slope),
        s=0.5 * (s[1:] + s[:-1]),
        ds=jnp.asarray(ds),
        in_tail=0.0 * one,
        joint=0.0 * one,
    )
    return jax.tree.map(jnp.asarray, AnimalBody(structure, jnp.asarray(width)))


class PrescribedMotion(eqx.Module):
    """A body, and the sections `x` from which effects compute forces. Axis 0 of `x` is time."""

    body: AnimalBody
    x: Section


def prescribe(motion: Motion, shape: CrossSections) -> PrescribedMotion:
    """Returns body and sections of an animal with this motion and shape in water at rest."""
    return _prescribe(jax.tree.map(jnp.asarray, motion), body_on_nodes(shape, motion.s))


@jax.jit
def _prescribe(motion: Motion, body: AnimalBody) -> PrescribedMotion:
    V_tau, V_n = to_body(jnp.moveaxis(motion.V, 2, 0), motion.phi)
    A_tau, A_n = to_body(jnp.moveaxis(motion.A, 2, 0), motion.phi)
    # The frame (tau, n) rotates at omega, so dV_tau/dt and dV_n/dt differ from A_tau and A_n.
    rates = (A_tau + motion.omega * V_n, A_n - motion.omega * V_tau, motion.omega)
    at = jax.vmap(_section, (None, 0, 0, 0))
    values = jnp.stack([V_tau, V_n, motion.phi], axis=1)
    return PrescribedMotion(body, at(body.structure, motion.t, values, jnp.stack(rates, axis=1)))


def _section(structure: Structure, t, y, y_t) -> Section:
    """Returns the sections at time `t`; `y` (3, nodes) is V_tau, V_n, phi, and `y_t` is dy/dt."""
    mid, mid_t = (0.5 * (v[:, 1:] + v[:, :-1]) for v in (y, y_t))
    slope, slope_t = ((v[:, 1:] - v[:, :-1]) / structure.ds for v in (y, y_t))
    dt = jnp.ones_like(t)
    before = mid - dt * mid_t
    reference = Reference(
        V_tau=before[0],
        V_n=before[1],
        phi=before[2],
        kappa=slope[2] - dt * slope_t[2],
        strain=jnp.zeros_like(mid[0]),
        internal=(),
        dt=dt,
        lag=structure.damping_time / dt,
    )
    no_load = jnp.zeros((3, *mid[0].shape))
    empty = jnp.zeros_like(mid[0])
    at, sloping = Fields(*no_load, *mid), Fields(*no_load, *slope)
    return section(at, sloping, structure, reference, None, empty, t)


@jax.jit
def force_on_body(effect: ForceDensity, p: PrescribedMotion) -> Float[Array, "times 2"]:
    """Returns the force (x, y) [N] of one effect on the whole body at every time."""
    F_tau, F_n = jax.vmap(effect.force)(p.x)
    per_length = jnp.stack(to_plane(F_tau, F_n, p.x.phi), axis=-1)
    return jnp.sum(per_length * p.body.structure.ds[:, None], axis=1)


@jax.jit
def momentum(p: PrescribedMotion) -> Float[Array, "times 2"]:
    """Returns the momentum (x, y) [N s] of the body without added mass, at every time."""
    return _mass_weighted(p, p.x.V_tau, p.x.V_n)


@jax.jit
def inertia(p: PrescribedMotion) -> Float[Array, "times 2"]:
    """Returns the time derivative (x, y) [N] of `momentum` at every time."""
    x = p.x
    return _mass_weighted(p, x.V_tau_t - x.omega * x.V_n, x.V_n_t + x.omega * x.V_tau)


def _mass_weighted(p: PrescribedMotion, tau, n) -> Float[Array, "times 2"]:
    vector = jnp.stack(to_plane(tau, n, p.x.phi), axis=-1)
    weight = p.body.structure.linear_density * p.body.structure.ds
    return jnp.sum(vector * weight[:, None], axis=1)
