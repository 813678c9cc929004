"""The Runge-Kutta step of the chamber pressure."""

import jax
import jax.numpy as jnp
import numpy as np

from slider_jax.dynamics import pressures


def written_out(rate, p, a0, a1, span):
    """Returns p after the same step, with its four stages written out."""
    middle = 0.5 * (a0 + a1)
    k1 = rate(p, a0)
    k2 = rate(p + 0.5 * span * k1, middle)
    k3 = rate(p + 0.5 * span * k2, middle)
    k4 = rate(p + span * k3, a1)
    return p + span / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


def test_the_loop_over_the_stages_is_the_classical_step():
    p, a0, a1 = jnp.array([1.0, -2.0]), jnp.array([3.0, 0.5]), jnp.array([2.0, 1.5])

    def step(scheme, k):
        return scheme(lambda p, a: (a - p) / k * (1.0 + 0.1 * p**2), p, a0, a1, 0.3)

    for derivative in (lambda f: f, jax.jacfwd, jax.jacrev):
        found, expected = (
            derivative(lambda k, scheme=scheme: step(scheme, k))(0.2)
            for scheme in (pressures._runge_kutta, written_out)
        )
        np.testing.assert_allclose(found, expected, rtol=1e-13)
