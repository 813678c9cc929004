"""Natural frequencies of the discrete rod, from the real residual linearised about rest."""

import jax
import numpy as np
import pytest

from slider_jax.beam.parameters import Numerics
from slider_jax.beam.state import straight_state
from slider_jax.effects import NormalDrag, ReactiveForce
from tests.support.helpers import flat_residual, nodes_of, stage_of, uniform

L, EI, MASS = 0.368, 0.038, 0.7
FINE = Numerics(tail_cells=10, body_cells=40)


def frequencies(model, numerics, count):
    """The lowest natural frequencies [Hz] of the discrete equations.

    The residual is R(y, (q(y) - q(y_ref))/dt). With dt = 1 and both at rest, C = -dR/dy_ref acts on
    dy/dt and K = dR/dy + dR/dy_ref on y; lambda C v + K v = 0.
    """
    y, _ = straight_state(nodes_of(model, numerics))

    def value(v, v_ref):
        stage = stage_of(model, numerics, v_ref.reshape(y.shape), 1.0)
        return flat_residual(v.reshape(y.shape), stage)

    by_y, by_ref = jax.jit(jax.jacfwd(value, argnums=(0, 1)))(y.ravel(), y.ravel())
    # dR/dy = K + C, so (K + C) v = (1 - lambda) C v: a shift, as K alone is singular (the clamp
    # imposes a rate).
    mu = np.linalg.eigvals(np.linalg.solve(by_y, -by_ref))
    mu = mu[np.abs(mu) > 1e-9]
    rates = 1.0 - 1.0 / mu
    oscillating = rates[rates.imag > 0]
    assert np.all(np.abs(oscillating.real[:10]) < 1e-3 * np.abs(oscillating[:10]))
    return np.sort(oscillating.imag)[:count] / (2.0 * np.pi)


def test_in_vacuo_frequencies_of_a_uniform_cantilever():
    found = frequencies(uniform(L, EI), FINE, 3)
    roots = np.array([1.87510407, 4.69409113, 7.85475744])
    exact = roots**2 * np.sqrt(EI / MASS) / L**2 / (2.0 * np.pi)
    off = np.abs(found / exact - 1.0)
    print(f"found {found} Hz, exact {exact} Hz, off {off}")
    assert np.all(off < [0.005, 0.01, 0.02])


def test_added_mass_lowers_the_first_frequency():
    dry = frequencies(uniform(L, EI), FINE, 1)[0]
    wet = frequencies(uniform(L, EI, (NormalDrag(0.0), ReactiveForce(1.0))), FINE, 1)[0]
    m_A = np.pi * 1000.0 * 0.03**2 / 4.0
    expected = dry * np.sqrt(MASS / (MASS + m_A))
    print(f"dry {dry:.5f} Hz, wet {wet:.5f} Hz, expected {expected:.5f} Hz")
    assert wet == pytest.approx(expected, rel=0.005)
