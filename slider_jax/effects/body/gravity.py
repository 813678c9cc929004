"""Weight and buoyancy, for a plane of motion that is not horizontal."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.parameters import Scalar
from slider_jax.beam.spatial import SpatialLoad, Vec
from slider_jax.beam.state import to_body
from slider_jax.effects.base import ForceDensity, parameter


class Gravity(ForceDensity):
    """Weight minus buoyancy per length. The x axis of a climbing robot points up.

        (F_x, F_y) = -(m - rho A) g/(1 + eps) (cos(up), sin(up))

    m is the mass and A the volume of displaced water, both per unstretched length; eps is the axial
    strain. If the upward direction has the angle `elevation` to the plane, the force along the
    plane is multiplied by cos(elevation), and a body in space also has the force along z. The
    centre of buoyancy of a body in space may lie beside the centre of mass. The couple of the two
    forces then rights the body.

    If the model has a waterline, A is multiplied by the wet fraction.

    In water, the tension T of the beam is the tension plus the pressure of the water times the
    cross-section, so it is 0 at a free end. Source: Archimedes' principle, Batchelor, G. K. (1967),
    An Introduction to Fluid Dynamics, Cambridge University Press, section 1.4.
    """

    title = "weight"
    order = 400
    segments = ("body", "tail")
    is_candidate = False
    needed_in_space = ("elevation",)
    needs_density = ("buoyancy_n", "buoyancy_b")
    in_air = True

    g: Scalar = parameter(
        0.0, 0.0, 9.81, "m/s^2", "9.81 if the plane of motion is vertical, 0 if it is horizontal"
    )
    """g, component of the acceleration of gravity in the plane of motion."""
    up: Scalar = eqx.field(default=0.0)
    """Angle [rad] of the upward direction from the x axis; 1.5708 if the y axis points up."""
    elevation: Scalar = eqx.field(default=0.0)
    """Angle [rad] of the upward direction from the plane (x, y); 1.5708 if the z axis points up."""
    buoyancy_n: Scalar = eqx.field(default=0.0)
    """Position [m] of the centre of buoyancy along n, relative to the centre of mass."""
    buoyancy_b: Scalar = eqx.field(default=0.0)
    """Position [m] of the centre of buoyancy along b, relative to the centre of mass."""
    density: Scalar = eqx.field(default=0.0)
    """Density rho [kg/m^3] of the water around the robot; 0 in air."""

    def force(self, x):
        area = x.area if x.wet is None or x.area is None else x.wet * x.area
        mass = x.linear_density if area is None else x.linear_density - self.density * area
        weight = mass * self.g * jnp.cos(self.elevation) / (1.0 + x.strain)
        return to_body((-weight * jnp.cos(self.up), -weight * jnp.sin(self.up)), x.phi)

    def vertical(self) -> Float[Array, "3"]:
        level = jnp.cos(self.elevation)
        axes = level * jnp.cos(self.up), level * jnp.sin(self.up), jnp.sin(self.elevation)
        return self.g * jnp.stack([jnp.asarray(a, float) for a in axes])

    def load_in_space(self, x):
        s, up = x.structure, x.frame.to_frame(self.vertical())
        per_length = 1.0 / (1.0 + x.strain)
        lift = jnp.zeros_like(per_length) if s.area is None else self.density * s.area * per_length
        arm = Vec(jnp.zeros_like(lift), self.buoyancy_n * lift, self.buoyancy_b * lift)
        return SpatialLoad(up.times(lift - s.linear_density * per_length), arm.cross(up))
