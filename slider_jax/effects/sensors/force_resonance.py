"""A force sensor that resonates with the mass on the sensor."""

import jax
import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Instrument, last_sample, parameter, shape_parameter
from slider_jax.effects.functions import resonant, resonant_sample


class ForceResonance(Instrument):
    """The sensor is a damped spring that carries a mass: the robot's head and the bracket.

        c (F_read'' + b F_read') + F_read = F

    F is the true force. c is mass/stiffness, so the natural frequency is 1/(2 pi sqrt(c)). With the
    fixed damping rate b, the damping ratio is b sqrt(c)/2. The reading is a smooth function of c at
    c = 0. Houbolt's backward differences in time are second-order and stable for any step. If the
    natural frequency is too high for the sample rate, the reading equals the force.

    Source: second-order instruments, Doebelin, E. O. (2003), Measurement Systems, 5th ed.,
    McGraw-Hill, ch. 3; Houbolt, J. C. (1950), A recurrence matrix solution for the dynamic response
    of elastic aircraft, J. Aeronaut. Sci. 17, 540-550.
    """

    title = "resonance of the force sensor"
    order = 620
    sensors = ("thrust", "recoil")

    mass_over_stiffness: Scalar = parameter(
        0.0, 0.0, 1e-4, "s^2", "0 for a stiff sensor, 1e-4 for a resonance at 16 Hz"
    )
    """c [s^2], mass divided by stiffness."""
    damping_rate: Scalar = shape_parameter(
        20.0, 2.0, 200.0, "1/s", "damping ratios of 0.01 to 1 for a resonance at 16 Hz"
    )
    """b, damping rate. With the default, the damping ratio is 0.1 for a resonance at 16 Hz."""

    def read(self, true):
        def series(force):
            return resonant(force, true.t, self.mass_over_stiffness, self.damping_rate)

        both = jax.vmap(series)(jnp.stack([true.thrust, true.recoil]))
        return true._replace(thrust=both[0], recoil=both[1])

    def read_sample(self, true, read):
        def sample(x, y):
            return resonant_sample(x, true.t, self.mass_over_stiffness, self.damping_rate, y)

        thrust, recoil = sample(true.thrust, read.thrust), sample(true.recoil, read.recoil)
        return last_sample(true)._replace(thrust=thrust, recoil=recoil)
