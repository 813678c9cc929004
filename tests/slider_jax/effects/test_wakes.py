"""Wake memory and the vortices at the edges: closed forms, and the states in the solver."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, special

from slider_jax.beam.parameters import Numerics
from slider_jax.beam.state import straight_state
from slider_jax.dynamics.residual import at_cells
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.effects import ReactiveForce, WakeForce, WaterMotion, in_space
from slider_jax.effects.base import total_force
from slider_jax.effects.body.stress_relaxation import StressRelaxation
from slider_jax.effects.water.edge_vortices import EdgeVortices
from slider_jax.effects.water.leading_edge_separation import LeadingEdgeSeparation
from slider_jax.effects.water.wake_memory import WakeMemory
from slider_jax.observables import recoil, thrust, tip
from slider_jax.swimming.gait import to_climber
from tests.support.helpers import SMALL, arrays, nodes_of, stage_of, swimmer, uniform

H, RHO, STREAM = 0.03, 1000.0, 1.0


class AcceleratingStream(WaterMotion):
    """A stream along the body whose velocity across the body grows at a constant rate."""

    title = "a stream that accelerates across the body"

    def velocity(self, t):
        return -STREAM * jnp.ones_like(t), 0.01 * t


class OscillatingStream(WaterMotion):
    """A stream along the body whose velocity across the body oscillates."""

    title = "a stream that oscillates across the body"
    frequency: float = 1.0

    def velocity(self, t):
        return -STREAM * jnp.ones_like(t), 0.01 * jnp.sin(2.0 * math.pi * self.frequency * t)


def wagner(x):
    """Wagner's function after x half chords of travel, from its exact integral.

    Source: Garrick, I. E. (1938), On some reciprocal relations in the theory of nonstationary
    flows, NACA Report 629.
    """

    def integrand(k):
        first = special.k0e(k) - special.k1e(k)
        second = math.pi * (special.i0e(k) + special.i1e(k))
        # The scaled functions contain the factors exp(k) and exp(-k).
        below = k**2 * (first**2 * math.exp(-4.0 * k) + second**2)
        return math.exp(-k * (x + 2.0)) / below

    parts = [integrate.quad(integrand, a, b, limit=200)[0] for a, b in ((0.0, 1.0), (1.0, np.inf))]
    return 1.0 - sum(parts)


def theodorsen(k):
    """Theodorsen's function at the reduced frequency k."""
    H_0, H_1 = special.hankel2(0, k), special.hankel2(1, k)
    return H_1 / (H_1 + 1j * H_0)


def force_of_stream(stream, effects, h, steps):
    """Force (steps,) [N] of the water across a stiff clamped plate in `stream`."""
    model = uniform(0.3, EI=1e6, effects=(*effects, arrays(stream)))

    def save(x):
        return jnp.sum(x.force_density()[1] * x.mesh.grid.ds)

    run = jax.jit(lambda m: rollout(m, TimeGrid(h, steps), save, SMALL, checkpoint=False))(model)
    assert run.ok
    return np.asarray(run.saved)


# Wake memory


@pytest.mark.parametrize("m_a", [1.0, 0.6])
def test_a_plate_in_a_suddenly_accelerating_stream_feels_wagners_force(m_a):
    """Within 1 % of the final force, from 0.5 to 30 half heights of travel (declared before)."""
    h, steps = 1e-3, 450
    effects = (ReactiveForce(m_a), WakeMemory(0.5 * m_a))
    found = force_of_stream(AcceleratingStream(), effects, h, steps)
    final = m_a * RHO * math.pi * H**2 / 4.0 * 0.3 * 0.01
    travel = STREAM * h * (np.arange(steps) + 1.0) / (0.5 * H)
    for x in (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0):
        at = np.interp(x, travel, found / final)
        assert abs(at - wagner(x)) < 0.01, (x, at, wagner(x))


def test_gain_and_phase_of_the_wake_are_those_of_its_law_and_near_theodorsens():
    """1e-3 of the law's closed form; 3 % of Theodorsen's function, which Jones approximates."""
    for k in (0.05, 0.2, 0.8):
        f = k * STREAM / (0.5 * H) / (2.0 * math.pi)
        per, strides = 400, max(3, math.ceil(12.0 * k / 0.0455 / (2.0 * math.pi)))
        h = 1.0 / (f * per)
        with_wake, without = (
            force_of_stream(OscillatingStream(f), effects, h, per * strides)[-per:]
            for effects in ((ReactiveForce(1.0), WakeMemory(0.5)), (ReactiveForce(1.0),))
        )
        turn = np.exp(-2j * np.pi * (np.arange(per) + 1.0) / per)
        found = np.sum(turn * with_wake) / np.sum(turn * without)
        law = 1.0 - sum(a * 1j * k / (1j * k + b) for a, b in ((0.165, 0.0455), (0.335, 0.3)))
        assert abs(found - law) < 1e-3, (k, found, law)
        assert abs(found - theodorsen(k)) < 0.03, (k, found, theodorsen(k))


def test_the_wakes_force_converges_at_second_order():
    model = swimmer(effects=(ReactiveForce(1.0), WakeMemory(0.4, travel=0.7)))

    def last(steps):
        def save(x):
            return jnp.stack([thrust(x), recoil(x), tip(x)])

        run = rollout(model, TimeGrid(0.02 / steps, steps), save, SMALL, checkpoint=False)
        assert run.ok
        return np.asarray(run.saved[-1])

    coarse, middle, fine = (last(n) for n in (40, 80, 160))
    order = np.log2(np.abs(coarse - middle) / np.abs(middle - fine))
    print("order of thrust, recoil and tip:", order)
    assert np.all(order > 1.7)


def test_each_effect_keeps_its_own_state():
    """A delayed part of size 0 changes no reading, whatever other states the model has."""
    relaxing = StressRelaxation(0.01, tau=0.05)
    wakes = (WakeMemory(0.0), WakeMemory(0.0, travel=3.0))

    def run(*effects):
        def save(x):
            return jnp.stack([thrust(x), recoil(x), tip(x)])

        model = swimmer(effects=(ReactiveForce(1.0), *effects))
        return rollout(model, TimeGrid(1.0 / 960.0, 60), save, SMALL, checkpoint=False)

    plain, among = run(relaxing), run(wakes[0], relaxing, wakes[1])
    np.testing.assert_allclose(among.saved, plain.saved, rtol=1e-10, atol=1e-13)
    first, second, strain = among.final.memory.internal
    assert first.shape == second.shape == (2, 16) and strain.shape == (16,)
    assert np.max(np.abs(first)) > np.max(np.abs(second)) > 0.0
    np.testing.assert_allclose(strain, plain.final.memory.internal[0], rtol=1e-9)


def test_the_wake_is_refused_in_space_and_left_out_in_air():
    assert not in_space(WakeMemory)
    climber = to_climber(swimmer(effects=(ReactiveForce(1.0), WakeMemory(0.3))), 2.0, 0.0)
    assert not any(isinstance(effect, WakeForce) for effect in climber.effects)


# Vortices at the edges


def oscillating(U, f, count=400):
    """Section of a straight rod whose cells see the phases of a sinusoidal u_n."""
    model = uniform(0.368)
    numerics = Numerics(tail_cells=count // 2, body_cells=count // 2)
    y, _ = straight_state(nodes_of(model, numerics))
    x = at_cells(y, stage_of(model, numerics, y, 1.0))
    phase = 2.0 * jnp.pi * jnp.arange(float(count)) / count
    u_n_t = -2.0 * math.pi * f * U * jnp.sin(phase)
    return dataclasses.replace(x, u_n=U * jnp.cos(phase), u_n_t=u_n_t), phase


@pytest.mark.parametrize("psi", [0.2, 0.5, 1.0])
def test_drag_and_added_mass_of_the_edges_belong_to_one_vortex_force(psi):
    """The force leads -u_n by psi at all amplitudes, and its size grows as U^2 KC^(-e)."""
    f, sizes = 4.0, []
    for KC in (3.0, 6.0, 12.0):
        U = KC * f * H
        x, phase = oscillating(U, f)
        _, F_n = arrays(EdgeVortices(8.0, phase=psi, stride_frequency=f)).force(x)
        first = 2.0 * np.mean(np.asarray(F_n) * np.exp(-1j * np.asarray(phase)))
        # The limit of KC raises the added mass slightly.
        angle = math.atan(math.tan(psi) * math.sqrt(1.0 + (0.3 / KC) ** 2))
        np.testing.assert_allclose(np.angle(-first), angle, rtol=1e-4)
        sizes.append(abs(first) / U**2)
        C_v = 8.0 * (KC**2 + 0.09) ** (-1.0 / 6.0)
        drag = 0.5 * RHO * H * C_v * U**2 * 8.0 / (3.0 * math.pi)
        np.testing.assert_allclose((-first).real, drag, rtol=1e-4)
    np.testing.assert_allclose(np.divide(sizes[1:], sizes[:-1]), 2.0 ** (-1.0 / 3.0), rtol=5e-3)


# Leading edge of the tail


def test_the_vortex_at_the_leading_edge_is_as_strong_as_the_suction():
    """For a tail that moves at the speed U, the force is K times pi rho H^2 U^2/8 at the joint."""
    K, U = 0.8, 0.7
    for sign in (1.0, -1.0):
        x, _ = oscillating(0.0, 1.0)
        x = dataclasses.replace(x, u_n=sign * U + 0.0 * x.s)
        F_tau, F_n = total_force(arrays((LeadingEdgeSeparation(K),)), x)
        assert not np.any(F_tau)
        suction = math.pi * RHO * H**2 * U**2 / 8.0
        np.testing.assert_allclose(np.sum(F_n * x.ds), -sign * K * suction, rtol=1e-12)
        where = np.sum(np.abs(F_n) * x.ds * x.s) / np.sum(np.abs(F_n) * x.ds)
        np.testing.assert_allclose(where, 0.2 * 0.368, rtol=1e-9)
