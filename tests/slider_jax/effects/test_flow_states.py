"""Effects of the flow into a chamber that have states, or that change the read pressure."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from slider_jax.beam.parameters import uniform_robot
from slider_jax.dynamics.model import Drive, Model
from slider_jax.dynamics.pressures import chamber_history, start_chambers
from slider_jax.effects.pneumatics.chamber_expansion import ATMOSPHERE
from slider_jax.effects.pneumatics.chamber_swing import ChamberSwing
from slider_jax.effects.pneumatics.converter_ripple import ConverterRipple
from slider_jax.effects.pneumatics.gas_heating import GasHeating
from slider_jax.effects.pneumatics.regulator_integral import RegulatorIntegral
from slider_jax.supports import Clamped
from tests.support.chambers import LAG, A, K, chambers, held, relaxation

T = np.linspace(0.0, 0.5, 501)


def test_gas_heating_is_a_linear_system_of_two_equations():
    a, tau, start, end = 0.4, 0.05, 0.2 * A, A
    M = np.array([[-(1.0 + a) / K, -1.0 / tau], [-a / K, -1.0 / tau]])
    exact = [(expm(M * t) @ [start - end, 0.0])[0] + end for t in T]
    found = relaxation(GasHeating(a, tau), start, end, T)
    np.testing.assert_allclose(found, exact, atol=1e-5 * A)
    assert np.max(np.abs(found - relaxation(GasHeating(0.0, tau), start, end, T))) > 0.03 * A


def test_an_integral_part_makes_the_pressure_a_damped_oscillator():
    """p'' + p'/k + c p = c p_set, so the pressure overshoots for c k^2 > 1/4."""
    c, start, end = 2.0 / K**2, 0.2 * A, A
    M = np.array([[-1.0 / K, c], [-1.0, 0.0]])
    exact = [(expm(M * t) @ [start - end, 0.0])[0] + end for t in T]
    found = relaxation(RegulatorIntegral(c), start, end, T)
    np.testing.assert_allclose(found, exact, atol=1e-5 * A)
    assert np.max(found) > 1.1 * A


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_swinging_body_agrees_with_an_adaptive_integrator(sign):
    """The states at the start are those of a body at rest."""
    effect, start, end = ChamberSwing(8e-7, 6.0, 0.2), sign * 0.9 * A, sign * 0.2 * A
    w = 2.0 * np.pi * 6.0

    def rates(t, y):
        p, at, speed = y
        dp = (end - p) / K - 8e-7 * (ATMOSPHERE + abs(p)) * speed
        return dp, speed, w**2 * (p - at) - 0.4 * w * speed

    exact = solve_ivp(rates, (0.0, 0.5), (start, start, 0.0), t_eval=T, rtol=1e-10, atol=1e-4)
    found = relaxation(effect, start, end, T)
    np.testing.assert_allclose(found, exact.y[0], atol=1e-5 * A)
    still = relaxation(ChamberSwing(0.0, 6.0, 0.2), start, end, T)
    assert np.max(np.abs(found - still)) > 0.03 * A


def test_the_states_of_two_effects_do_not_mix():
    """The order of the effects does not matter if one of them is at its null."""
    heating, still = GasHeating(0.3, 0.05), ChamberSwing(0.0)
    alone = chambers([heating], held(A), held(-A), T, 0.1 * A).p
    for effects in ([heating, still], [still, heating]):
        np.testing.assert_allclose(chambers(effects, held(A), held(-A), T, 0.1 * A).p, alone)


def test_the_regulator_controls_the_reading_of_the_converter():
    """The reading is the true pressure plus the error, and only the true pressure obeys the lag."""
    a, b, c, d, period = 2e3, -1e3, 1.5e3, 0.5e3, 0.2 * A
    turn = 2.0 * np.pi / period

    def rate(t, p):
        slope = turn * (a * np.cos(turn * p) - b * np.sin(turn * p))
        slope += 0.5 * turn * (c * np.cos(0.5 * turn * p) - d * np.sin(0.5 * turn * p))
        return (1.0 + slope) * (A - p) / K

    exact = solve_ivp(rate, (0.0, 0.5), (0.1 * A,), t_eval=T, rtol=1e-10, atol=1e-4).y[0]
    found = relaxation(ConverterRipple(a, b, c, d, period), 0.1 * A, A, T)
    np.testing.assert_allclose(found, exact, atol=1e-5 * A)
    assert np.max(np.abs(found - relaxation(ConverterRipple(), 0.1 * A, A, T))) > 2e3


@pytest.mark.parametrize(
    "effect",
    [
        GasHeating(0.2, 0.05),
        pytest.param(ChamberSwing(5e-7, 4.0, 0.2), marks=pytest.mark.slow),
        pytest.param(RegulatorIntegral(90.0), marks=pytest.mark.slow),
    ],
)
@pytest.mark.slow
def test_derivatives_reach_the_parameters_through_the_states(effect):
    leaves, structure = jax.tree.flatten(effect)

    def last(x):
        flows = (jax.tree.unflatten(structure, list(x)),)
        drive = Drive((held(0.2 * A), held(0.2 * A)), 0.9 * A)
        model = Model(uniform_robot(), flows, LAG, drive, Clamped())
        return chamber_history(model, start_chambers(model), jnp.asarray(T[:101])).p[-1, 0]

    at = jnp.asarray(leaves)
    forward, reverse = jax.jacfwd(last)(at), jax.jacrev(last)(at)
    np.testing.assert_allclose(forward, reverse, rtol=1e-9)
    step = 1e-5 * np.diag(np.asarray(at))
    differences = [(last(at + h) - last(at - h)) / (2.0 * h.max()) for h in step]
    np.testing.assert_allclose(forward, differences, rtol=1e-5)
