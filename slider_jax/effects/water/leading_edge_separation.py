"""Force of the vortices that separate at the leading edge of the tail."""

import math

import equinox as eqx
import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ForceDensity, parameter


class LeadingEdgeSeparation(ForceDensity):
    """The flow separates where the tail begins, and the suction at this edge turns sideways.

        F_n = -K pi rho H^2/8 |u_n| u_n delta(s - s_joint)

    H is the height of the body in the two cells next to the joint. The attached flow around a
    leading edge of this height pulls it forward with the suction pi rho H^2/8 u_n^2. If the flow
    separates, the low pressure of the vortex acts on the side instead, with the same size
    (Polhamus). K is the fraction of the suction that does so. The model without `TailAddedMass` has
    no forward suction at the joint, so the effect has no tangential force.

    Source: Polhamus, E. C. (1966), A concept of the vortex lift of sharp-edge delta wings based on
    a leading-edge-suction analogy, NASA TN D-3767; attached suction: Jones, R. T. (1946),
    Properties of low-aspect-ratio pointed wings at speeds below and above the speed of sound, NACA
    Report 835.
    """

    title = "the flow separates at the leading edge of the tail"
    order = 506

    K: Scalar = parameter(
        0.0, 0.0, 2.0, "-", "1 for a sharp edge as high as the tail; 2 for edges on both sides"
    )
    """K, force divided by the suction of an attached flow."""
    density: Scalar = eqx.field(default=1000.0)
    """Density rho [kg/m^3] of the water."""

    def force(self, x):
        suction = math.pi * self.density * x.height**2 / 8.0 * x.u_n * jnp.abs(x.u_n)
        return jnp.zeros_like(suction), -self.K * suction * x.joint
