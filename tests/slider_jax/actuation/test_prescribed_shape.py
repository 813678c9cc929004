"""A body that follows a prescribed curvature: its motion, its forces, and its mean thrust."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.actuation import TravellingWave, midline_shape, recorded_shape
from slider_jax.beam.parameters import Numerics, grid_of
from slider_jax.beam.state import node_positions
from slider_jax.dynamics.statics import Loads
from slider_jax.dynamics.step import at_rest
from slider_jax.effects import ReactiveForce
from slider_jax.errors import InputError
from slider_jax.supports import Clamped, Free
from tests.support.helpers import (
    SMALL,
    arrays,
    march,
    observe,
    order,
    static_state,
    swimmer,
    uniform,
)

L = 0.368
FINE = Numerics(tail_cells=10, body_cells=40)


def with_actuators(model, *actuators):
    return arrays(replace(model, actuators=actuators))


def wave(scale=1.0, **changes):
    """A wave of curvature that grows towards the tail, with 1.2 wavelengths on the body."""
    shape = {"near": 0.0, "far": L, "frequency": 2.0, "wavelength": 0.3, "bias": 0.1}
    return TravellingWave(**shape | {"amplitude": (2.0 * scale, 5.0 * scale, 0.0)} | changes)


def towed(effects=(ReactiveForce(1.0),), speed=0.3, **robot):
    return uniform(L, effects=effects, support=Clamped(tow_speed=speed), **robot)


def curvature(x):
    return x.section().kappa


def distances(model, numerics):
    grid = grid_of(model.body, numerics)
    return np.asarray(grid.s[-1] - grid.mid(grid.s))


@pytest.mark.slow
def test_curvature_follows_in_the_span_and_the_rest_of_the_body_is_elastic():
    """1 % of the largest curvature at 250 steps per period; the error is of second order."""
    actuator = wave(near=0.1, far=0.25)
    model = with_actuators(towed(damping_time=1e-3), actuator)
    at = distances(model, SMALL)
    inside = (at > 0.1) & (at < 0.25)
    errors = []
    for steps in (120, 240):
        t, kappa = march(model, 0.5 / steps, steps, curvature)
        wanted = np.stack([actuator.curvature(at, x) for x in t])
        off = np.abs(kappa - wanted)
        errors.append(off[:, inside].max())
    print("largest error of the curvature", errors, "1/m")
    assert errors[1] < 0.01 * np.abs(wanted).max()
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)
    assert off[:, ~inside].max() > 0.2 * np.abs(wanted).max()


@pytest.mark.slow
def test_curvature_does_not_drift():
    """After 20 periods, the error at the end of a period is below 1e-6 of the amplitude."""
    model = with_actuators(towed(), wave())
    _, kappa = march(model, 0.5 / 40, 800, curvature)
    at = distances(model, SMALL)
    wanted = np.asarray(wave().curvature(at, 0.0))
    off = np.abs(kappa[39::40] - wanted).max(axis=1) / np.abs(wanted).max()
    print(f"error after one period {off[0]:.1e}, after twenty {off[-1]:.1e}")
    assert off.max() < 1e-6


@pytest.mark.slow
def test_a_free_body_starts_in_the_shape_and_keeps_its_momentum():
    """In vacuum, the momentum stays at its start to 1e-3 of mass times the speed of the tail."""
    model = with_actuators(uniform(L, support=Free(), damping_time=1e-3), wave(scale=3.0))
    begin = at_rest(model, SMALL)
    at = distances(model, SMALL)
    grid = grid_of(model.body, SMALL)
    wanted = np.asarray(wave(scale=3.0).curvature(at, 0.0))
    assert np.asarray(grid.slope(begin.memory.motion[2])) == pytest.approx(wanted, abs=1e-9)

    def momentum(x):
        section = x.section()
        c, s = jnp.cos(section.phi), jnp.sin(section.phi)
        velocity = jnp.stack(
            [c * section.V_tau - s * section.V_n, s * section.V_tau + c * section.V_n]
        )
        density = x.mesh.structure.linear_density
        return jnp.append(x.mesh.grid.integral(density * velocity), jnp.max(jnp.abs(velocity)))

    _, saved = march(model, 0.5 / 400, 400, momentum)
    size = float(model.body.mass) * saved[:, 2].max()
    change = np.abs(saved[:, :2] - saved[0, :2]).max() / size
    print(f"change of momentum {change:.1e}")
    assert change < 1e-3


@pytest.mark.slow
def test_static_state_has_the_prescribed_curvature_in_the_span():
    """Exact in the span; behind the span, the unloaded body is straight."""
    actuator = wave(near=0.1, far=0.25)
    model = with_actuators(uniform(L), actuator)
    found = static_state(model, Loads(jnp.zeros(2), jnp.zeros(2)), SMALL, t=0.2)
    at = distances(model, SMALL)
    wanted = np.where((at > 0.1) & (at < 0.25), actuator.curvature(at, 0.2), 0.0)
    kappa = np.asarray(grid_of(model.body, SMALL).slope(found.y[5]))
    assert bool(found.ok)
    assert kappa == pytest.approx(wanted, abs=1e-8)


@pytest.mark.slow
def test_recorded_curvature_of_a_pneumatic_beam_gives_its_clamp_forces():
    """Thrust and recoil to 0.5 % of their rms (tolerance declared before the test was run)."""
    beam = swimmer(frequency=2.0, k=0.087)
    steps, h = 1600, 5e-4

    def save(x):
        return observe(x)[:2], curvature(x)

    t, (forces, kappa) = march(beam, h, steps, save)
    times = np.concatenate([[0.0], t])
    samples = np.concatenate([np.zeros((1, kappa.shape[1])), kappa])
    at = distances(beam, SMALL)
    follows = recorded_shape(0.0, L, at[::-1], times, samples[:, ::-1])
    still = swimmer(frequency=2.0, amplitude=0.0)
    _, (found, _) = march(with_actuators(still, follows), h, steps, save)
    rms = np.sqrt(np.mean(forces**2, axis=0))
    off = np.sqrt(np.mean((found - forces) ** 2, axis=0)) / rms
    print(f"rms error: thrust {100 * off[0]:.3f} %, recoil {100 * off[1]:.3f} % of their rms")
    assert np.all(off < 0.005)


def test_recorded_midline_gives_its_curvature():
    """An arc of curvature 1.5 1/m that turns, to 0.1 %, at either sign."""
    times, turn = np.linspace(0.0, 1.0, 5), np.linspace(0.0, 0.5, 61)
    for kappa in (1.5, -1.5):
        angle = 0.3 * times[:, None] + kappa * turn
        midline = np.stack([np.sin(angle), 1.0 - np.cos(angle)], axis=1) / kappa
        shape = midline_shape(times, midline)
        found = shape.curvature(jnp.linspace(0.05, 0.45, 7), jnp.asarray(0.4))
        assert np.asarray(found) == pytest.approx(kappa, rel=1e-3)
        assert shape.far == pytest.approx(0.5, rel=1e-3)


@pytest.mark.slow
def test_midline_and_curvature_agree_for_a_simulated_body():
    """The nodes of the body give back the curvature of the inner cells to 1 % of the largest."""
    model = with_actuators(towed(), wave(scale=3.0))

    def save(x):
        return node_positions(x.y[5], x.memory.strain, x.head, x.mesh.grid), curvature(x)

    t, (nodes, kappa) = march(model, 0.5 / 120, 120, save, numerics=FINE)
    shape = midline_shape(t, nodes)
    at = distances(model, FINE)
    found = np.asarray(shape.curvature(jnp.asarray(at[2:-2]), jnp.asarray(t[60])))
    assert found == pytest.approx(kappa[60, 2:-2], abs=0.01 * np.abs(kappa).max())


@pytest.mark.parametrize("samples", [np.zeros((5, 4)), np.full((5, 3), np.nan)])
def test_wrong_samples_of_a_shape_are_an_input_error(samples):
    with pytest.raises(InputError, match=r"curvature of a recorded shape: given .* allowed"):
        recorded_shape(0.0, L, np.arange(3.0), np.arange(5.0), samples)


def test_unsorted_times_and_a_flat_midline_are_an_input_error():
    with pytest.raises(InputError, match="times of a recorded shape"):
        recorded_shape(0.0, L, np.arange(3.0), np.arange(5.0)[::-1], np.zeros((5, 3)))
    with pytest.raises(InputError, match="recorded midline"):
        midline_shape(np.arange(5.0), np.zeros((5, 2)))


def lateral_motion(actuator, turns, points=4000):
    """h_t and h_x at the tail over one period in the linear theory, clamped at the head."""
    d = (np.arange(points) + 0.5) * L / points

    def slope_and_height(t):
        kappa = actuator.curvature(d, t)
        return jnp.stack([-jnp.sum(kappa), jnp.sum((L - d) * kappa)]) * L / points

    t = jnp.asarray(turns) / actuator.frequency
    both, rates = jax.vmap(lambda t: jax.jvp(slope_and_height, (t,), (jnp.ones_like(t),)))(t)
    return np.asarray(rates[:, 1]), np.asarray(both[:, 0])


@pytest.mark.slow
def test_mean_thrust_of_a_small_wave_is_that_of_lighthill():
    """1 % (declared before): T = m_A/2 (<h_t^2> - U^2 <h_x^2>) at the tail.

    Source: Lighthill, M. J. (1960), Note on the swimming of slender fish, J. Fluid Mech. 9,
    305-317.
    """
    speed, water = 0.3, ReactiveForce(1.0)
    ratios = []
    for scale in (0.1, 0.4):
        actuator = wave(scale, bias=0.0)
        model = with_actuators(towed((water,), speed, damping_time=1e-3), actuator)
        _, saved = march(model, 0.5 / 400, 800, numerics=FINE)
        h_t, h_x = lateral_motion(actuator, np.arange(400) / 400)
        m_A = float(water.added_mass(model.robot.body.height))
        theory = 0.5 * m_A * np.mean(h_t**2 - speed**2 * h_x**2)
        found = saved[400:, 0].mean()
        ratios.append(found / theory)
        print(f"scale {scale}: mean thrust {1e3 * found:.4f} mN, Lighthill {1e3 * theory:.4f} mN")
    assert ratios[0] == pytest.approx(1.0, abs=0.01)


@pytest.mark.slow
def test_orders_of_the_forces():
    """Recoil, linear in the motion, is of second order; thrust is of first order as at a clamp."""
    model = with_actuators(towed(damping_time=1e-3), wave(0.1))
    steps = [80, 160, 320, 1280]
    runs = [march(model, 0.5 / n, n)[1][n // 8 - 1 :: n // 8] for n in steps]
    errors = [np.abs(run - runs[-1])[:, :2].max(axis=0) for run in runs[:-1]]
    thrust, recoil = (order([1.0 / n for n in steps[:-1]], x) for x in np.transpose(errors))
    print(f"order of thrust {thrust:.2f}, of recoil {recoil:.2f}")
    assert recoil > 1.8
    assert thrust > 0.9
