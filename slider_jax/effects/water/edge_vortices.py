"""Force of the vortices at the edges of an oscillating section: drag with added mass."""

import math

import equinox as eqx
import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ForceDensity, parameter, shape_parameter
from slider_jax.effects.water.keulegan_carpenter_drag import squared_KC

KC_MIN = 0.3
"""Smallest KC, an amplitude of H/20. This limit keeps the drag coefficient finite."""


class EdgeVortices(ForceDensity):
    """Drag and added mass that change with the stroke amplitude and belong to one vortex force.

        F_n    = -rho C_v H |u_n| u_n/2 - C_m rho pi H^2/4 du_n/dt
        C_v    = C KC^(-e)
        C_m    = 8 tan(psi)/(3 pi^3) KC C_v

    KC is the Keulegan-Carpenter number, as in `KeuleganCarpenterDrag`, and a smooth limit keeps KC
    above 0.3. The force is in addition to the drag and the added mass of the base model. If u_n
    is sinusoidal, the fundamental of F_n leads -u_n by the angle psi at all amplitudes, because the
    growth of the vortices is self-similar. KC^(-e) of the drag and KC^(1-e) of the added mass are
    therefore a pair; `KeuleganCarpenterDrag` is the drag without this added mass (psi = 0).

    Source: Graham, J. M. R. (1980), The forces on sharp-edged cylinders in oscillatory flow at low
    Keulegan-Carpenter numbers, J. Fluid Mech. 97, 331-346: for a plate, e = 1/3 and C = 8.
    """

    title = "drag and added mass that change together with amplitude"
    order = 504

    C: Scalar = parameter(
        0.0, 0.0, 10.0, "-", "8 for a plate with sharp edges; smaller for round edges or large C_d"
    )
    """C, drag coefficient of the vortices at KC = 1."""
    phase: Scalar = shape_parameter(
        0.5, 0.1, 1.1, "rad", "added mass of plates rises by 1 to 3 up to KC = 10: 0.3 to 0.75 rad"
    )
    """psi, angle by which the force leads -u_n."""
    exponent: Scalar = shape_parameter(
        1.0 / 3.0, 0.05, 0.7, "-", "1/3 for a plate; smaller for a section with blunt edges"
    )
    """e, exponent of the decrease of the drag coefficient."""
    stride_frequency: Scalar = eqx.field(default=5.0)
    """Drive frequency f [Hz] of the trial."""
    density: Scalar = eqx.field(default=1000.0)
    """Density rho [kg/m^3] of the water."""

    def force(self, x):
        C_v, m_A = self._coefficient_and_mass(x)
        drag = 0.5 * self.density * C_v * x.height * jnp.abs(x.u_n) * x.u_n
        F_n = -drag - m_A * x.u_n_t
        return jnp.zeros_like(F_n), F_n

    def entrained_mass(self, x):
        return self._coefficient_and_mass(x)[1]

    def _coefficient_and_mass(self, x):
        """Returns the drag coefficient [-] and the added mass [kg/m] of the vortices."""
        KC_2 = squared_KC(x, self.stride_frequency) + KC_MIN**2
        C_v = self.C * KC_2 ** (-0.5 * self.exponent)
        C_m = 8.0 * jnp.tan(self.phase) / (3.0 * math.pi**3) * jnp.sqrt(KC_2) * C_v
        return C_v, C_m * self.density * math.pi * x.height**2 / 4.0
