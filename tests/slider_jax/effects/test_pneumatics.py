"""Set pressure, flow and acting pressure: each effect's history against a closed form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.actuation import Ideal, Recorded, SquareWave
from slider_jax.beam.parameters import uniform_robot
from slider_jax.dynamics.model import make_mesh
from slider_jax.effects.library import DICTIONARY
from slider_jax.effects.pneumatics.actuator_creep import ActuatorCreep
from slider_jax.effects.pneumatics.actuator_hysteresis import ActuatorHysteresis
from slider_jax.effects.pneumatics.actuator_quadratic import ActuatorQuadratic
from slider_jax.effects.pneumatics.actuator_saturation import ActuatorSaturation
from slider_jax.effects.pneumatics.actuator_threshold import ActuatorThreshold
from slider_jax.effects.pneumatics.chamber_crosstalk import ChamberCrosstalk
from slider_jax.effects.pneumatics.chamber_expansion import ATMOSPHERE, ChamberExpansion
from slider_jax.effects.pneumatics.chamber_mismatch import ChamberMismatch
from slider_jax.effects.pneumatics.choked_flow import ChokedFlow
from slider_jax.effects.pneumatics.drive_clock import DriveClock
from slider_jax.effects.pneumatics.flow_exponent import FlowExponent
from slider_jax.effects.pneumatics.leakage import Leakage
from slider_jax.effects.pneumatics.line_lag import LineLag
from slider_jax.effects.pneumatics.orifice_flow import OrificeFlow, characteristic
from slider_jax.effects.pneumatics.rear_valve_delay import RearValveDelay
from slider_jax.effects.pneumatics.regulator_gain import RegulatorGain
from slider_jax.effects.pneumatics.regulator_offset import RegulatorOffset
from slider_jax.effects.pneumatics.relief_leak import ReliefLeak
from slider_jax.effects.pneumatics.side_lag import SideLag
from slider_jax.effects.pneumatics.side_mismatch import SideMismatch
from slider_jax.effects.pneumatics.supply_depletion import SupplyDepletion
from slider_jax.effects.pneumatics.supply_limit import SupplyLimit
from tests.support.chambers import (
    LAG,
    A,
    F,
    K,
    chambers,
    held,
    pressure_history,
    relaxation,
    square,
    strides,
)
from tests.support.helpers import SMALL, order

FLOWS = [
    ChokedFlow(5e-7),
    Leakage(2.0),
    FlowExponent(0.4),
    OrificeFlow(0.8),
    ChamberExpansion(4e-6),
    SideLag(0.4),
]
COUPLED = [
    DICTIONARY["flow_between_chambers"](a=-0.1, b=-0.2),
    DICTIONARY["filling_opening_of_other"](a=-0.2, b=-0.1),
]


def test_supply_pressure_is_never_exceeded_and_is_half_at_its_own_set_pressure():
    t, p_supply = np.linspace(0.0, 40.0 * K, 200), 4e5
    final = [relaxation(SupplyLimit(1.0 / p_supply), 0.0, p, t)[-1] for p in (1e3, 4e5, -4e5, 4e8)]
    np.testing.assert_allclose(final, [1e3, 2e5, -2e5, 4e5], rtol=3e-3)
    assert final[3] < p_supply


def test_regulator_gain_and_offset_superpose_on_the_linear_lag():
    t = strides(40)
    plain = square([], t).p
    np.testing.assert_allclose(square([RegulatorGain(-0.1)], t).p, 0.9 * plain, rtol=1e-12)
    shift = 7e3 * (1.0 - np.exp(-t / K))
    got = square([RegulatorOffset(7e3)], t).p
    np.testing.assert_allclose(got - plain, np.stack([shift, shift], 1), atol=1e-6)


def test_rear_valve_delay_shifts_only_the_rear_chamber():
    t, late = strides(100), 3
    plain = square([], t).p
    got = square([RearValveDelay(late * t[1])], t).p
    np.testing.assert_array_equal(got[:, 0], plain[:, 0])
    np.testing.assert_array_equal(got[: late + 1, 1], 0.0)
    np.testing.assert_allclose(got[late:, 1], plain[:-late, 1], atol=1e-6)


@pytest.mark.parametrize("slow", [0.02, -0.03])
def test_a_slow_clock_of_the_drive_lowers_its_frequency(slow):
    t = strides(114)
    front, rear = (SquareWave(F * (1.0 - slow), A, phase) for phase in (0.0, 0.15))
    expected = chambers([], front, rear, t).p
    assert np.max(np.abs(expected - square([], t).p)) > 0.1 * A
    np.testing.assert_allclose(square([DriveClock(slow)], t).p, expected, atol=1e-6 * A)


def test_the_tangent_of_a_slow_clock_is_the_difference_of_pressures():
    """Edges move in proportion to the time; 0.3 s avoids the edges themselves."""
    t = jnp.asarray(np.append(np.arange(0.0, 0.3, 0.004), 0.3))

    def last(slow):
        return pressure_history(LAG, DriveClock(slow).command(SquareWave(F, A), 0), 0.0, t)[-1]

    difference = (last(jnp.asarray(1e-4)) - last(jnp.asarray(-1e-4))) / 2e-4
    assert abs(difference) > 0.1 * A
    np.testing.assert_allclose(jax.jacfwd(last)(jnp.asarray(0.0)), difference, rtol=1e-5)


def test_a_wrong_clock_does_not_hide_the_start_of_a_delayed_wave():
    """The derivative by a delay of zero includes the start of the wave."""
    t = jnp.asarray(np.append(np.arange(0.0, 0.1, 0.0037), 0.1))

    def last(delay):
        wave = DriveClock(0.013).command(SquareWave(F, A), 1)
        return pressure_history(LAG, RearValveDelay(delay).command(wave, 1), 0.0, t)[-1]

    exact = -A * np.exp(-0.1 / K) / K  # dp/d(delay) of the step response A (1 - exp(-t/k))
    np.testing.assert_allclose(jax.jacfwd(last)(jnp.asarray(0.0)), exact, rtol=1e-6)


@pytest.mark.parametrize("effect", FLOWS, ids=lambda e: e.name())
@pytest.mark.slow
def test_flow_converges_for_steps_that_the_loop_takes(effect):
    """The loop takes 114 steps a stride, 4 ms; the reference steps are a sixteenth of that.

    An orifice's flow ends with a square root as the chamber empties; 1e-4 is 25 Pa.
    """
    coarse, fine = square([effect], strides(114)).p, square([effect], strides(16 * 114)).p
    off = np.max(np.abs(coarse - fine[::16])) / A
    changed = np.max(np.abs(coarse - square([], strides(114)).p)) / A
    print(f"{effect.name()}: off {off:.1e}, changed {changed:.1e}")
    assert changed > 0.02
    assert off < (1e-4 if isinstance(effect, OrificeFlow) else 2e-5)


@pytest.mark.parametrize("effect", COUPLED, ids=lambda e: e.name())
def test_a_flow_that_depends_on_both_chambers_has_an_error_of_half_a_percent(effect):
    """A step is split at the edge of each chamber's own set pressure.

    Each stage of a split step therefore belongs to two different times. The error is of first order
    in the step.
    """
    fine = square([effect], strides(16 * 114)).p
    coarse = [square([effect], strides(n)).p for n in (114, 228)]
    errors = [np.max(np.abs(coarse[0] - fine[::16])), np.max(np.abs(coarse[1] - fine[::8]))]
    assert 0.1 * A < np.max(np.abs(coarse[0] - square([], strides(114)).p))
    assert errors[0] < 5e-3 * A and errors[1] < 0.7 * errors[0]


def test_smooth_flow_is_fourth_order_in_the_step():
    sizes = np.array([10, 20, 40])
    t = [np.linspace(0.0, 0.3, n + 1) for n in sizes]
    exact = A / (1.0 + 9.0 * K) * (1.0 - np.exp(-(1.0 / K + 9.0) * 0.3))
    errors = [abs(relaxation(Leakage(9.0), 0.0, A, x)[-1] - exact) for x in t]
    assert -order(sizes, errors) == pytest.approx(4.0, abs=0.3)


def test_leaking_chamber_settles_lower_and_sooner():
    t = np.linspace(0.0, 0.5, 251)
    q = 2.5
    exact = A / (1.0 + q * K) * (1.0 - np.exp(-(1.0 / K + q) * t))
    np.testing.assert_allclose(relaxation(Leakage(q), 0.0, A, t), exact, rtol=1e-6)


def test_a_relief_leak_opens_at_its_pressure_on_both_sides():
    q, opening, t = 9.0, 120e3, np.linspace(0.0, 1.2, 1201)
    for sign in (1.0, -1.0):
        p = sign * relaxation(ReliefLeak(q, opening), 0.0, sign * A, t)
        lag = A * (1.0 - np.exp(-t / K))
        closed = lag < opening
        np.testing.assert_allclose(p[closed], lag[closed], rtol=1e-5, atol=1e-3)
        assert p[-1] == pytest.approx((A + q * K * opening) / (1.0 + q * K), rel=1e-6)


def test_left_and_right_chambers_fill_with_their_own_time_constants():
    x, t = 0.3, np.linspace(0.0, 0.4, 201)
    left, right = (relaxation(SideLag(x), 0.0, p_set, t) for p_set in (A, -A))
    np.testing.assert_allclose(left, A * (1.0 - np.exp(-t / (1.3 * K))), rtol=1e-6, atol=1e-3)
    np.testing.assert_allclose(right, -A * (1.0 - np.exp(-t / (0.7 * K))), rtol=1e-6, atol=1e-3)


def test_an_emptying_supply_lowers_the_set_pressure_exponentially():
    """k dp/dt = A exp(-r t) - p, from the pressure at the first time."""
    r, t = 0.3, np.linspace(0.0, 2.0, 401)
    exact = A * (np.exp(-r * t) - np.exp(-t / K)) / (1.0 - r * K)
    p = relaxation(SupplyDepletion(r), 0.0, A, t)
    np.testing.assert_allclose(p, exact, atol=1e-6 * A)


def test_an_emptying_supply_keeps_the_edges_of_the_drive():
    """A short lag follows the set pressure: a square wave times the exponential."""
    r, t = 0.5, strides(40)
    p = square([SupplyDepletion(r)], t, law=Ideal()).p
    np.testing.assert_allclose(p, np.exp(-r * t)[:, None] * square([], t, law=Ideal()).p)


def test_choked_chamber_fills_linearly_before_it_relaxes():
    """dt = -(k/e + c) de: t = k log(e_0/e) + c (e_0 - e); the rate stays below 1/c."""
    c, t = 8e-7, np.linspace(0.0, 0.6, 601)
    p = relaxation(ChokedFlow(c), -A, A, t)
    e = A - p
    np.testing.assert_allclose(K * np.log(2.0 * A / e) + c * (2.0 * A - e), t, atol=1e-7)
    rate = np.diff(p) / np.diff(t)
    assert 0.8 / c < rate[0] < 1.0 / c


def test_square_root_flow_closes_the_gap_in_finite_time():
    """At b = 1/2 sqrt(e) falls linearly, to zero at 2 k sqrt(e_0/p_ref)."""
    t = np.linspace(0.0, 4.0 * K, 601)
    e = A - relaxation(FlowExponent(0.5), 0.0, A, t)
    falling = e > 50e3
    exact = np.sqrt(A) - np.sqrt(100e3) * t / (2.0 * K)
    np.testing.assert_allclose(np.sqrt(e[falling]), exact[falling], rtol=2e-3)
    end = 2.0 * K * np.sqrt(A / 100e3)
    assert t[falling][-1] < 0.6 * end
    assert e[t > end][0] < 0.01 * A < A * np.exp(-end / K)


def test_characteristic_is_the_ideal_nozzles_within_two_percent():
    """Saint-Venant and Wantzel's nozzle for air, critical at 0.528."""
    r, gamma = np.linspace(0.55, 0.99, 45), 1.4
    nozzle = np.sqrt(r ** (2.0 / gamma) - r ** ((gamma + 1.0) / gamma))
    choked = 2.0 / (gamma + 1.0)
    largest = np.sqrt(choked ** (2.0 / (gamma - 1.0)) * (1.0 - choked))
    critical = choked ** (gamma / (gamma - 1.0))
    np.testing.assert_allclose(characteristic(r, critical), nozzle / largest, rtol=0.02)
    assert np.all(characteristic(np.array([0.0, 0.2, 0.5]), critical) == 1.0)
    assert characteristic(1.0, critical) == characteristic(1.2, critical) == 0.0


def test_orifice_is_the_lag_while_filling_is_choked():
    """From 60 kPa until the ratio of absolute pressures is critical, at 109 kPa."""
    t = np.linspace(0.0, 0.008, 21)
    p = relaxation(OrificeFlow(1.0), 60e3, 500e3, t)
    assert 95e3 < p[-1] < 0.3 * (600e3 + ATMOSPHERE) - ATMOSPHERE
    np.testing.assert_allclose(p - 60e3, 440e3 * (1.0 - np.exp(-t / K)), rtol=1e-6)


def test_choked_venting_is_proportional_to_the_absolute_pressure():
    """dx/dt = -x (x + D)/(k S) with x = p - p_set, D = p_set + p_a, S = p_s + p_a: logistic."""
    p_set, start, S = 50e3, 500e3, 600e3 + ATMOSPHERE
    D, t = p_set + ATMOSPHERE, np.linspace(0.0, 0.07, 71)
    share = (start - p_set) / (start - p_set + D) * np.exp(-D * t / (K * S))
    exact = p_set + D * share / (1.0 - share)
    assert exact[-1] > 240e3
    np.testing.assert_allclose(relaxation(OrificeFlow(1.0), start, p_set, t), exact, rtol=1e-6)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_expanding_chamber_takes_the_mass_that_flows_in(sign):
    """d((p_a + |p|) (1 + c |p|))/dt is the flow of the rigid chamber, |p| being large."""
    c, t = 4e-6, np.linspace(0.0, 0.1, 101)
    start, p_set = 150e3, 900e3
    p = sign * relaxation(ChamberExpansion(c), sign * start, sign * p_set, t)
    mass = (ATMOSPHERE + p) * (1.0 + c * p)
    inflow = (p_set - p) / K
    taken = np.concatenate([[0.0], np.cumsum(0.5 * (inflow[1:] + inflow[:-1]) * np.diff(t))])
    np.testing.assert_allclose(mass - mass[0], taken, rtol=1e-4, atol=1.0)


def test_line_lag_is_exact_on_a_ramp_with_uneven_steps():
    tau, slope = 0.02, 1e6
    steps = np.random.default_rng(0).uniform(0.001, 0.05, 30)
    t = np.concatenate([[0.0], np.cumsum(steps)])
    ramp = Recorded(jnp.asarray([0.0, 10.0]), jnp.asarray([0.0, 10.0 * slope]))
    got = chambers([LineLag(tau)], ramp, ramp, t, law=Ideal())
    np.testing.assert_allclose(got.p[:, 0], slope * t, rtol=1e-12)
    exact = slope * (t - tau * (1.0 - np.exp(-t / tau)))
    np.testing.assert_allclose(got.acting[:, 1], exact, rtol=1e-10)


def test_creep_is_exact_on_a_ramp_and_adds_its_share_in_the_end():
    tau, share, slope = 0.02, 0.3, 1e6
    steps = np.random.default_rng(0).uniform(0.001, 0.05, 30)
    t = np.concatenate([[0.0], np.cumsum(steps)])
    ramp = Recorded(jnp.asarray([0.0, 10.0]), jnp.asarray([0.0, 10.0 * slope]))
    got = chambers([ActuatorCreep(share, tau)], ramp, ramp, t, law=Ideal())
    slow = slope * (t - tau * (1.0 - np.exp(-t / tau)))
    np.testing.assert_allclose(got.acting[1:, 0], (slope * t + share * slow)[1:], rtol=1e-10)
    held_long = chambers([ActuatorCreep(share, tau)], held(A), held(A), np.linspace(0.0, 3.0, 301))
    np.testing.assert_allclose(held_long.acting[-1], (1.0 + share) * A, rtol=1e-9)


def test_line_lag_behind_the_valves_lag_converges_to_two_lags_in_series():
    tau, sizes = 0.02, np.array([20, 40, 80])

    def error(n):
        t = np.linspace(0.0, 0.2, n + 1)
        y = chambers([LineLag(tau)], held(A), held(A), t).acting[:, 0]
        exact = 1.0 - (K * np.exp(-t / K) - tau * np.exp(-t / tau)) / (K - tau)
        return np.max(np.abs(y / A - exact))

    assert -order(sizes, [error(n) for n in sizes]) == pytest.approx(2.0, abs=0.2)


def test_line_starts_and_stays_at_the_start_pressure():
    got = chambers([LineLag(0.03)], held(A), held(A), np.linspace(0.0, 0.2, 41), start=A)
    np.testing.assert_allclose(got.acting, A, rtol=1e-12)


def acting(effect, p_front, p_rear):
    """Acting pressures (2,) of an effect without memory."""
    p = jnp.asarray([p_front, p_rear])
    return np.asarray(effect.act(p, jnp.stack([p, p]), 1e-3)[0])


def test_saturation_loses_half_and_the_quadratic_part_doubles_at_the_inverse():
    """Both are odd, vanish at small pressures, and have opposite signs to first order."""
    less, more = ActuatorSaturation(1.0 / A), ActuatorQuadratic(1.0 / A)
    np.testing.assert_allclose(acting(less, A, -A), [A / 2.0, -A / 2.0])
    np.testing.assert_allclose(acting(more, A, -A), [2.0 * A, -2.0 * A])
    for effect in (less, more):
        np.testing.assert_allclose(acting(effect, 1.0, -10.0), [1.0, -10.0], rtol=1e-4)
    assert np.all(np.abs(acting(less, 1e9, -1e9)) < A)
    np.testing.assert_allclose(
        acting(less, 0.01 * A, 0.0) + acting(more, 0.01 * A, 0.0), [0.02 * A, 0.0], rtol=2e-4
    )


def test_left_and_right_chambers_bend_by_their_own_share():
    np.testing.assert_allclose(acting(SideMismatch(0.2), A, -A), [1.2 * A, -0.8 * A], rtol=1e-12)


def test_a_threshold_is_lost_at_high_pressure_and_softens_low_pressure():
    p_0, w = 20e3, 10e3
    effect = ActuatorThreshold(p_0, w)
    np.testing.assert_allclose(acting(effect, 3e6, -3e6), [3e6 - p_0, p_0 - 3e6], rtol=1e-5)
    np.testing.assert_allclose(acting(effect, 10.0, -10.0), [10.0 / 3.0, -10.0 / 3.0], rtol=1e-5)
    p = np.linspace(-A, A, 1001)
    assert np.all(np.diff([acting(effect, x, x)[0] for x in p[::20]]) > 0.0)


def span_moments(effect, p_front, p_rear):
    """Moments [N m] in the middle of the front and of the rear chamber."""
    robot, mesh = uniform_robot(), make_mesh(uniform_robot(), SMALL)
    moment = acting(effect, p_front, p_rear) @ mesh.chambers
    middles = [robot.length - np.mean(c) for c in robot.chambers]
    return np.interp(middles, mesh.structure.s, moment)


def test_mismatch_moves_moment_from_the_rear_to_the_front():
    plain, moved = (span_moments(ChamberMismatch(d), A, A) for d in (0.0, 0.2))
    np.testing.assert_allclose(plain, uniform_robot().K_Q * A, rtol=1e-12)
    np.testing.assert_allclose(moved / plain, [1.2, 0.8], rtol=1e-12)


def test_crosstalk_bends_the_span_of_the_empty_chamber():
    c = 0.15
    front, rear = span_moments(ChamberCrosstalk(c), 0.0, A)
    assert front == pytest.approx(c * rear)
    front, rear = span_moments(ChamberCrosstalk(c), A, 0.0)
    assert rear == pytest.approx(c * front)
    antagonists = span_moments(ChamberCrosstalk(c), A, -A)
    expected = (1.0 - c) * uniform_robot().K_Q * A * np.array([1.0, -1.0])
    np.testing.assert_allclose(antagonists, expected)


def triangle(per_branch, duration):
    """Times, and a triangular pressure from 0 between A and -A, three times."""
    corners = A * np.array([0.0, 1.0, -1.0, 1.0, -1.0, 1.0])
    at = np.concatenate([[0.0], np.arange(0.5, 5.0)]) * duration
    wave = Recorded(jnp.asarray(at), jnp.asarray(corners))
    branch = [np.linspace(a, b, per_branch + 1)[1:] for a, b in zip(at[:-1], at[1:], strict=True)]
    return np.concatenate([[0.0], *branch]), wave


def test_hysteresis_settles_into_its_closed_loop_at_any_speed_and_step():
    """Up from -A: z = 1 - (1 + Z) exp(-(p + A)/w), whose ends are +-Z = +-tanh(A/w)."""
    height, w = 30e3, 50e3
    loops = []
    for per_branch, duration in [(60, 0.1), (60, 7.0), (240, 0.1)]:
        t, wave = triangle(per_branch, duration)
        got = chambers([ActuatorHysteresis(height)], wave, wave, t, law=Ideal())
        last = slice(4 * per_branch, None, per_branch // 60)
        p, held_back = got.p[last, 0], (got.p - got.acting)[last, 0]
        loops.append(held_back)
        exact = 1.0 - (1.0 + np.tanh(A / w)) * np.exp(-(p + A) / w)
        np.testing.assert_allclose(held_back / height, exact, atol=1e-4)
    np.testing.assert_allclose(loops[0], loops[1], rtol=1e-9)
    np.testing.assert_allclose(loops[0], loops[2], rtol=1e-9)


def test_hysteresis_dissipates_the_work_of_its_loop():
    """Work on a volume proportional to the acting pressure: 4 A_h (A - w tanh(A/w)) a loop."""
    height, w = 30e3, 50e3
    t, wave = triangle(60, 1.0)
    got = chambers([ActuatorHysteresis(height)], wave, wave, t, law=Ideal())
    p, volume = got.p[180:, 0], got.acting[180:, 0]
    assert p[0] == pytest.approx(p[120])
    work = np.sum(0.5 * (p[1:] + p[:-1]) * np.diff(volume))
    assert work == pytest.approx(4.0 * height * (A - w * np.tanh(A / w)), rel=0.01)
