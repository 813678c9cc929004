"""Valves, limits and hoses that change or replace the lag, each against its closed form."""

import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.actuation import FirstOrderLag
from slider_jax.effects import Chamber
from slider_jax.effects.pneumatics.chamber_expansion import ATMOSPHERE
from slider_jax.effects.pneumatics.fill_vent_asymmetry import FillVentAsymmetry
from slider_jax.effects.pneumatics.firmware_valves import FirmwareValves
from slider_jax.effects.pneumatics.lag_mismatch import LagMismatch
from slider_jax.effects.pneumatics.proportional_valves import ProportionalValves
from slider_jax.effects.pneumatics.pulsed_valves import PulsedValves
from slider_jax.effects.pneumatics.rate_limit import RateLimit
from slider_jax.effects.pneumatics.relief_leak import ReliefLeak
from slider_jax.effects.pneumatics.supply_cap import SupplyCap
from slider_jax.effects.pneumatics.valve_deadband import ValveDeadband
from slider_jax.effects.pneumatics.valve_overlap import ValveOverlap
from slider_jax.effects.valve_pair import FULL_DUTY_ERROR, MAX_DUTY
from tests.support.chambers import A, K, chambers, held, relaxation, square, strides

OPEN = (MAX_DUTY - 0.05) / 0.95
"""Share of full flow above `FULL_DUTY_ERROR`, for a valve that opens at a duty of 0.05."""


@pytest.mark.parametrize(
    ("effect", "allowed"),
    [
        (FillVentAsymmetry(0.4), 2e-6),
        (FillVentAsymmetry(2.5), 2e-6),
        (RateLimit(4e-7), 2e-5),
        (ReliefLeak(8.0), 1e-4),
        (ValveOverlap(20e3), 2e-5),
        (ValveDeadband(20e3), 1e-3),
        (FirmwareValves(2.0, 2.0), 1e-3),
        (PulsedValves(2.0, 2.0), 1e-3),
        (ProportionalValves(2.0, 2.0), 1e-3),
    ],
    ids=lambda x: x.name() if hasattr(x, "name") else "",
)
@pytest.mark.slow
def test_converges_for_steps_that_the_loop_takes(effect, allowed):
    """The loop takes 114 steps a stride, 4 ms; the reference, a sixteenth. 1e-3 is 250 Pa."""
    coarse, fine = square([effect], strides(114)).p, square([effect], strides(16 * 114)).p
    off = np.max(np.abs(coarse - fine[::16])) / A
    assert np.max(np.abs(coarse - square([], strides(114)).p)) > 0.005 * A
    assert off < allowed


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_reversal_vents_slowly_to_zero_and_fills_from_there(sign):
    r, t = 1.7, np.linspace(0.0, 0.4, 201)
    p = sign * relaxation(FillVentAsymmetry(r), sign * A, -sign * A, t)
    empty = r * K * np.log(2.0)
    venting = A * (2.0 * np.exp(-t / (r * K)) - 1.0)
    filling = -A * (1.0 - np.exp(-(t - empty) / K))
    np.testing.assert_allclose(p, np.where(t < empty, venting, filling), atol=1e-5 * A)


def test_deadband_is_the_lag_until_it_stops_short_of_the_set_point():
    d, t = 20e3, np.linspace(0.0, 1.0, 501)
    p = relaxation(ValveDeadband(d), 0.0, A, t)
    lag = A * (1.0 - np.exp(-t / K))
    far = A - lag > 1.3 * d
    np.testing.assert_allclose(p[far], lag[far], rtol=1e-3)
    assert 0.85 * d < A - p[-1] < d
    inside = relaxation(ValveDeadband(d), A - 0.7 * d, A, t)
    np.testing.assert_allclose(inside, inside[0], rtol=1e-6)


def test_overlap_settles_where_the_valve_closes():
    d, t = 20e3, np.linspace(0.0, 0.8, 401)
    exact = (A - d) * (1.0 - np.exp(-t / K))
    np.testing.assert_allclose(relaxation(ValveOverlap(d), 0.0, A, t), exact, rtol=1e-5, atol=1e-3)


def test_limited_flow_is_linear_in_time_and_then_follows_the_lag():
    R, t = 1e6, np.linspace(0.0, 0.6, 601)
    p = relaxation(RateLimit(1.0 / R), 0.0, A, t)
    turn = (A - R * K) / R
    exact = np.where(t < turn, R * t, A - R * K * np.exp(-(t - turn) / K))
    np.testing.assert_allclose(p, exact, atol=4e-3 * A)


def test_cap_does_not_change_set_pressures_below_it():
    t = np.linspace(0.0, 30.0 * K, 200)
    final = [relaxation(SupplyCap(1.0 / 2e5), 0.0, p, t)[-1] for p in (1.5e5, 3e5, -3e5)]
    np.testing.assert_allclose(final, [1.5e5, 2e5, -2e5], rtol=1e-5)


def test_rear_chamber_has_its_own_lag():
    t = strides(60)
    plain, slow = square([], t).p, square([LagMismatch(0.5)], t).p
    np.testing.assert_allclose(slow[:, 0], plain[:, 0], atol=1e-9)
    at = np.linspace(0.0, 0.5, 251)
    rear = chambers([LagMismatch(0.5)], held(A), held(A), at).p[:, 1]
    np.testing.assert_allclose(rear, A * (1.0 - np.exp(-at / (1.5 * K))), rtol=1e-6)


def test_firmware_opens_in_proportion_up_to_its_widest():
    """Choked, the chamber vents with its absolute pressure and fills at a constant rate."""
    t = np.linspace(0.0, 0.2, 201)
    valves = FirmwareValves(fill=1.5, vent=2.0, supply=600e3, critical=0.5)
    p = relaxation(valves, 500e3, 100e3, t)
    choked = p + ATMOSPHERE > ATMOSPHERE / 0.5 + 1e3
    exact = (500e3 + ATMOSPHERE) * np.exp(-2.0 * OPEN * t) - ATMOSPHERE
    assert choked.sum() > 100
    np.testing.assert_allclose(p[choked], exact[choked], rtol=1e-6)
    p = relaxation(valves, 0.0, 400e3, t)
    choked = p + ATMOSPHERE < 0.5 * (600e3 + ATMOSPHERE) - 1e3
    assert choked.sum() > 100
    slope = 1.5 * OPEN * (600e3 + ATMOSPHERE)
    np.testing.assert_allclose(p[choked], (slope * t)[choked], rtol=1e-6, atol=1.0)
    small = relaxation(valves, 100e3, 100e3 + 0.2 * FULL_DUTY_ERROR, np.array([0.0, 1e-5]))
    flow = (0.2 * MAX_DUTY - 0.05) / 0.95 * 1.5 * (600e3 + ATMOSPHERE)
    assert (small[1] - small[0]) / 1e-5 == pytest.approx(flow, rel=1e-3)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_proportional_valves_open_with_a_lag_and_are_choked_far_from_the_ends(sign):
    """Choked, the chamber vents with its absolute pressure and fills at a constant rate."""
    t, n, tau = np.linspace(0.0, 0.2, 401), 6.0, 8e-3
    valves = ProportionalValves(1.5, 2.0, 600e3, 0.5, 0.5, 0.55, 0.62, n, tau)
    open_for = t - tau * (1.0 - np.exp(-t / tau))
    p = sign * relaxation(valves, sign * 500e3, sign * 100e3, t)
    choked = p + ATMOSPHERE > ATMOSPHERE / 0.5 + 1e3
    u = MAX_DUTY**n / (MAX_DUTY**n + 0.62**n)
    exact = (500e3 + ATMOSPHERE) * np.exp(-2.0 * u * open_for) - ATMOSPHERE
    assert choked.sum() > 200
    np.testing.assert_allclose(p[choked], exact[choked], rtol=1e-4)
    p = sign * relaxation(valves, 0.0, sign * 400e3, t)
    choked = p + ATMOSPHERE < 0.5 * (600e3 + ATMOSPHERE) - 1e3
    u = MAX_DUTY**n / (MAX_DUTY**n + 0.55**n)
    exact = 1.5 * u * (600e3 + ATMOSPHERE) * open_for
    assert choked.sum() > 200
    np.testing.assert_allclose(p[choked], exact[choked], rtol=1e-4, atol=1.0)


@pytest.mark.parametrize(("half", "which"), [(0.55, 0), (0.62, 1)])
def test_a_proportional_valve_has_half_of_its_flow_at_the_declared_duty(half, which):
    """The other valve stays closed."""
    valves = ProportionalValves(1.5, half_fill=0.55, half_vent=0.62, response=5e-3)
    error = half / MAX_DUTY * FULL_DUTY_ERROR * (1.0 - 2.0 * which)
    p = jnp.full(2, 2e5)
    x = Chamber(p, p + error, jnp.asarray(0.1), np.array([0.0, 1.0]), jnp.ones(2), valves.start(p))
    wanted = np.asarray(valves.state_rates(jnp.zeros(2), x)) * 5e-3
    np.testing.assert_allclose(wanted[which], 0.5, rtol=1e-12)
    assert np.all(wanted[1 - which] < 1e-6)


@pytest.mark.parametrize(
    "valves", [FirmwareValves(fill=1.5), PulsedValves(fill=1.5), ProportionalValves(fill=1.5)]
)
def test_the_lag_does_not_affect_valves_that_replace_it(valves):
    """This holds even if its time constant is a fraction of the step."""
    t = strides(57)
    slow, quick = (square([valves], t, law=FirstOrderLag(k)).p for k in (0.2, 0.002))
    np.testing.assert_array_equal(slow, quick)


def test_laminar_valves_approach_the_supply_and_the_room():
    t = np.linspace(0.0, 0.1, 101)
    valves = PulsedValves(fill=1.5, vent=2.0, supply=600e3)
    p = relaxation(valves, 0.0, 500e3, t)
    np.testing.assert_allclose(p, 600e3 * (1.0 - np.exp(-1.5 * OPEN * t)), rtol=1e-6, atol=1e-3)
    p = relaxation(valves, 500e3, 0.0, t)
    np.testing.assert_allclose(p, 500e3 * np.exp(-2.0 * OPEN * t), rtol=1e-6)
