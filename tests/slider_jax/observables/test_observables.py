"""Observables against closed forms, and the energy balance of a whole stride."""

import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax import observables as obs
from slider_jax.actuation import SineWave
from slider_jax.beam.parameters import Numerics
from slider_jax.beam.state import fields, to_body, to_plane
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.effects import Gravity, NormalDrag, ReactiveForce, total_force
from slider_jax.paper import force_coefficients
from slider_jax.supports import Clamped
from tests.support.energy_balance import clamp_power, energy_rates
from tests.support.helpers import SMALL, march, swimmer

F, L = 3.0, 0.368
S = jnp.linspace(0.0, L, 41)
T = jnp.arange(1.0, 241.0) / (F * 120)  # two strides


def wave(wavelength, amplitude=lambda s: 0.01 + 0.0 * s, direction=1.0):
    """y(t, s) of a wave that runs to the tail (direction 1) or to the head (-1)."""
    k = 2 * np.pi / wavelength
    return amplitude(S) * jnp.sin(2 * np.pi * F * T[:, None] + direction * k * S + 0.4)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_wavelength_and_speed_of_a_travelling_wave_are_exact(direction):
    y = wave(0.25, direction=direction)
    mode = obs.fundamental_mode(y, T, F)
    found = obs.body_wave(mode, S, F)
    np.testing.assert_allclose(found.wavelength, direction * 0.25, rtol=1e-9)
    np.testing.assert_allclose(found.speed, direction * 0.25 * F, rtol=1e-9)
    np.testing.assert_allclose(jnp.abs(mode), 0.01, rtol=1e-9)


def test_fundamental_ignores_the_mean_and_the_harmonics():
    y = wave(0.25) + 0.02 + 0.005 * jnp.sin(6 * np.pi * F * T)[:, None]
    np.testing.assert_allclose(
        obs.fundamental_mode(y, T, F), obs.fundamental_mode(wave(0.25), T, F), atol=1e-14
    )


def test_the_wave_of_a_clamped_body_is_fitted_where_it_moves_and_is_differentiable():
    def fitted(wavelength):
        y = wave(wavelength, amplitude=lambda s: 0.03 * (1 - s / L) ** 2)  # still at the head
        return obs.body_wave(obs.fundamental_mode(y, T, F), S, F).wavelength

    np.testing.assert_allclose(fitted(0.5), 0.5, rtol=1e-9)
    np.testing.assert_allclose(jax.grad(fitted)(0.5), 1.0, rtol=1e-6)


MOTIONS = {
    "travelling, still head": lambda k: wave(k, amplitude=lambda s: 0.03 * (1 - s / L) ** 2),
    "travelling, no gap between the singular values": lambda k: wave(L / 2 + 0.0 * k),
    "standing": lambda k: k * (wave(0.3) + wave(0.3, direction=-1.0)),
    "nothing moves": lambda k: 0.0 * wave(k),
}


@pytest.mark.parametrize("motion", MOTIONS)
def test_wave_observables_have_finite_derivatives(motion):
    def observed(k):
        y = MOTIONS[motion](k)
        mode = obs.fundamental_mode(y, T, F)
        speed = obs.body_wave(mode, S, F).speed
        travels = motion.startswith("travelling")
        squares = obs.travelling_index(mode) ** 2 + jnp.abs(mode[0]) ** 2
        squares = squares + (0.0 if motion == "nothing moves" else obs.shape_wavelength(mode, S))
        return squares + (speed if travels else 0.0)

    slope = float(jax.grad(observed)(0.5))
    central = float((observed(0.5 + 1e-6) - observed(0.5 - 1e-6)) / 2e-6)
    assert slope == pytest.approx(central, rel=1e-4, abs=1e-6)


def test_travelling_index_is_one_for_a_travelling_and_zero_for_a_standing_wave():
    travelling = obs.fundamental_mode(wave(L / 2), T, F)  # two whole waves on the body
    # The end point repeats the first, so the sums of squares are a point off: leave it out.
    np.testing.assert_allclose(obs.travelling_index(travelling[:-1]), 1.0, atol=1e-6)
    standing = obs.fundamental_mode(wave(0.3) + wave(0.3, direction=-1.0), T, F)
    np.testing.assert_allclose(obs.travelling_index(standing), 0.0, atol=1e-6)


@pytest.mark.parametrize("standing", [0.0, 0.5, 1.0])
def test_the_shape_wavelength_is_that_of_a_travelling_or_standing_wave(standing):
    """On a body of three half waves; one that only stands has no phase to tell it from."""
    y = wave(2 * L / 3) + standing * wave(2 * L / 3, direction=-1.0)
    mode = obs.fundamental_mode(y, T, F)
    assert float(obs.travelling_index(mode)) == pytest.approx(
        (1 - standing) / (1 + standing), abs=0.03
    )
    np.testing.assert_allclose(obs.shape_wavelength(mode, S), 2 * L / 3, rtol=4e-3)
    np.testing.assert_allclose(obs.shape_wavelength(1e3j * mode, S), 2 * L / 3, rtol=4e-3)


@pytest.mark.parametrize("wavelength", [0.2, 0.3, 0.5, 1.5])
def test_the_wavelength_of_a_travelling_shape_needs_no_whole_waves(wavelength):
    found = obs.shape_wavelength(obs.fundamental_mode(wave(wavelength), T, F), S)
    np.testing.assert_allclose(found, wavelength, rtol=4e-3)


def test_the_wavelength_of_a_body_that_moves_sideways_is_infinite():
    mode = jnp.full(41, 0.01 + 0.02j)
    assert float(obs.shape_wavelength(mode, S)) == np.inf
    assert np.all(np.isfinite(jax.grad(lambda a: jnp.tanh(obs.shape_wavelength(a * mode, S)))(1.0)))


def test_stride_statistics_are_those_of_each_stride():
    series = jnp.asarray([1.0, 3.0, 5.0, 5.0])
    np.testing.assert_array_equal(obs.stride_means(series, 2), [2.0, 5.0])
    with pytest.raises(ValueError, match="allowed a multiple of"):
        obs.stride_means(series, 3)


def test_dimensionless_numbers_of_swimming_are_their_formulas():
    assert obs.strouhal_number(2.0, 0.1, 0.5) == pytest.approx(0.4)
    assert obs.froude_efficiency(0.06, 0.2, 0.05) == pytest.approx(0.24)
    assert obs.force_efficiency(0.06, 0.05) == pytest.approx(1.2)
    assert obs.tail_slope(0.05, 0.4) == pytest.approx(0.5)


def test_coefficients_follow_the_papers_ramp():
    C_d, m_a = jax.vmap(force_coefficients)(jnp.asarray([0.4, 2.0, 2.5, 2.8, 3.0, 7.0]))
    np.testing.assert_allclose(C_d, [4.0, 4.0, 3.5, 3.2, 3.0, 3.0], rtol=1e-12)
    np.testing.assert_allclose(m_a, [0.0, 0.0, 0.5, 0.8, 1.0, 1.0], atol=1e-12)


def everything(x):
    section, integral = x.section(), x.mesh.grid.integral
    head = fields(x.y[:, -1])
    F_tau, F_n = total_force(x.stage.effects, section)
    in_plane = jnp.stack(to_plane(F_tau, F_n, section.phi))
    velocity = jnp.stack(to_plane(section.V_tau, section.V_n, section.phi))
    return dict(
        rates=energy_rates(x),
        energy=obs.stored_energy(x).total,
        force=jnp.stack(to_plane(-head.T, -head.N, head.phi)),
        thrust=obs.thrust(x),
        recoil=obs.recoil(x),
        phi_head=x.y[5, -1],
        water=integral((1.0 + section.strain) * in_plane),
        momentum=integral(section.linear_density * velocity),
    )


@pytest.mark.slow
def test_every_observable_of_a_snapshot_is_differentiable():
    """To C_d, after 20 steps from rest, forward and by central differences."""

    def saved(x):
        shape = (obs.midline(x), obs.lateral(x), obs.tip(x))
        return everything(x), shape, obs.chamber_power(x), clamp_power(x)

    @jax.jit
    def last(C_d):
        out = rollout(swimmer(C_d=C_d), TimeGrid(1e-3, 20), saved, SMALL)
        return jax.flatten_util.ravel_pytree(jax.tree.map(lambda q: q[-1], out.saved))[0]

    at, h = jnp.asarray(3.0), 1e-3
    slope = jax.jit(lambda C_d: jax.jvp(last, (C_d,), (jnp.ones(()),))[1])(at)
    central = (last(at + h) - last(at - h)) / (2.0 * h)
    assert np.count_nonzero(slope) > 0.5 * slope.size
    np.testing.assert_allclose(slope, central, rtol=1e-5, atol=1e-9)


STEPS = 240
HEAVED = Clamped(tow_speed=0.2, heave=0.004, pitch=0.1, frequency=4.8, pitch_phase=0.3)


def record(support):
    """Two strides under gravity in water, with a smooth drive."""
    effects = (NormalDrag(3.0), ReactiveForce(1.0), Gravity(1.0))
    model = swimmer(support=support, effects=effects, wave=SineWave)
    return march(model, 1.0 / (4.8 * STEPS), 2 * STEPS, everything)


@pytest.fixture(scope="module")
def moving() -> tuple[np.ndarray, dict]:
    """A towed, heaved and pitched clamp; its start is a jolt."""
    return record(HEAVED)


@pytest.fixture(scope="module")
def still() -> tuple[np.ndarray, dict]:
    """A clamp at rest. (Under one that pitches the thrust converges at an order of about 1.5.)"""
    return record(Clamped())


@pytest.mark.slow
def test_power_balances_at_every_instant_under_a_moving_clamp_and_gravity(moving):
    rates = moving[1]["rates"]
    left = rates.put_in - rates.stored.total - rates.dissipated - rates.to_effects
    scale = float(jnp.max(jnp.abs(rates.put_in[50:])))
    assert scale > 0.1
    assert len(rates.given) == 3
    np.testing.assert_allclose(left[50:], 0.0, atol=1e-8 * scale)


@pytest.mark.slow
def test_rate_of_stored_energy_is_the_derivative_of_the_energy(still):
    """By the trapezoid rule over the second stride; only the error of the step is left."""
    h = float(still[0][1] - still[0][0])
    rate = still[1]["rates"].stored.total[STEPS:]
    energy = still[1]["energy"][STEPS:]
    gained = h * jnp.cumsum(0.5 * (rate[1:] + rate[:-1]))
    np.testing.assert_allclose(gained, energy[1:] - energy[0], atol=1e-3 * float(jnp.ptp(energy)))


def test_force_in_the_carriages_axes_is_the_sensors_turned_by_the_pitch(moving):
    t, out = moving
    angle = HEAVED.carriage(t)[1]
    np.testing.assert_allclose(out["phi_head"], angle, atol=1e-4)
    assert float(jnp.max(jnp.abs(angle))) > 0.05
    turned = to_body((out["force"][:, 0], out["force"][:, 1]), angle)
    np.testing.assert_allclose(turned[0], out["thrust"], atol=1e-12)
    np.testing.assert_allclose(turned[1], out["recoil"], atol=1e-12)


def test_force_on_the_clamp_and_of_the_water_change_the_bodys_momentum(still):
    """In the tank's axes, over the second stride: only the error of the step is left."""
    h = float(still[0][1] - still[0][0])
    force = (still[1]["water"] - still[1]["force"])[STEPS:]
    momentum = still[1]["momentum"][STEPS:]
    impulse = h * jnp.cumsum(0.5 * (force[1:] + force[:-1]), axis=0)
    error = jnp.max(jnp.abs(momentum[1:] - momentum[0] - impulse), axis=0)
    np.testing.assert_allclose(error / jnp.ptp(momentum, axis=0), 0.0, atol=1e-3)


@pytest.mark.slow
def test_work_over_a_steady_stride_is_stored_dissipated_or_given_to_the_water():
    """The acceptance line: N_p = 51, h = 0.496 ms at 4.8 Hz, by the trapezoid rule."""
    steps, numerics = 420, Numerics()
    assert numerics.nodes == 51
    h = 1.0 / (4.8 * steps)
    assert h <= 0.5e-3
    _, out = march(swimmer(), h, 4 * steps, everything, numerics, chunk=60)
    last = slice(-steps - 1, None)

    def work(power):
        power = power[last]
        return float(h * (jnp.sum(power) - 0.5 * (power[0] + power[-1])))

    rates, energy = out["rates"], out["energy"]
    put_in, water = work(rates.put_in), work(rates.to_effects)
    left = put_in - work(rates.dissipated) - water - float(energy[-1] - energy[-1 - steps])
    print(f"work {1e3 * put_in:.3f} mJ, to water {1e3 * water:.3f} mJ, left {left / put_in:.2e}")
    assert put_in > 0.01 and water > 0.5 * put_in
    assert abs(float(energy[-1] - energy[-1 - steps])) < 0.05 * put_in  # nearly steady
    assert abs(left) < 1e-4 * put_in  # the bar is 5e-3
