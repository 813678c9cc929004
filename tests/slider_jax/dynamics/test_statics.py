"""Static shapes of a cantilever through the real residual, loaded at the tail's tip."""

import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.beam.parameters import Numerics
from slider_jax.beam.state import node_positions, straight_state, to_body
from slider_jax.dynamics.model import make_mesh
from tests.support.helpers import dense_newton, nodes_of, order, stage_of, uniform

L, EI = 0.368, 0.038


def static_shape(tail_load, numerics):
    """Midline (2, N) of the clamped uniform rod at rest under a load on its tail's end."""
    model = uniform(L, EI)
    y, _ = straight_state(nodes_of(model, numerics))
    y, error = dense_newton(stage_of(model, numerics, y, 1e9), y, tail_load)
    assert error < 1e-9
    mesh = make_mesh(model.robot, numerics)
    return node_positions(y[5], mesh.grid.mid(y[0]) / mesh.structure.EA, jnp.zeros(2), mesh.grid), y


def dead_load(x, y):
    """A force (x, y) [N] that keeps its direction, pulling on the tail's end."""

    def tail_load(phi):
        return jnp.stack([*to_body((-x, -y), phi), 0.0])

    return tail_load


def couple(C):
    def tail_load(phi):
        return jnp.stack([0.0 * phi, 0.0 * phi, -C + 0.0 * phi])

    return tail_load


END_LOAD = dead_load(0.0, EI / L**2)
FINE = Numerics(tail_cells=10, body_cells=40)


def elastica_tip():
    """Deflection over L of the elastica under P L^2/EI = 1, by shooting with 400 RK4 steps.

    theta'' + P cos(theta)/EI = 0 from the clamp, theta(0) = 0, theta'(1) = 0.
    """
    n = 400
    h = 1.0 / n

    def slope(z):
        return np.array([z[1], -np.cos(z[0]), np.sin(z[0])])

    def end(curvature):
        z = np.array([0.0, curvature, 0.0])
        for _ in range(n):
            a = slope(z)
            b = slope(z + 0.5 * h * a)
            c = slope(z + 0.5 * h * b)
            z = z + h / 6.0 * (a + 2 * b + 2 * c + slope(z + h * c))
        return z

    low, high = 0.5, 1.5
    f_low, f_high = end(low)[1], end(high)[1]
    for _ in range(20):
        low, high = high, high - f_high * (high - low) / (f_high - f_low)
        f_low, f_high = f_high, end(high)[1]
        if abs(f_high) < 1e-12:
            break
    return end(high)[2]


def test_end_load_bends_the_tip_by_the_elastica():
    shape, _ = static_shape(END_LOAD, FINE)
    tip = float(shape[1, 0]) / L
    print(f"tip {tip:.6f} L, elastica 0.30172 L, off {abs(tip / 0.30172 - 1):.2e}")
    assert elastica_tip() == pytest.approx(0.30172, abs=1e-5)
    assert tip == pytest.approx(0.30172, rel=1e-3)


@pytest.mark.slow
def test_end_load_is_second_order_in_space():
    exact = elastica_tip()
    cells = [10, 20, 40]
    meshes = [Numerics(tail_cells=n // 5, body_cells=n - n // 5) for n in cells]
    errors = [abs(float(static_shape(END_LOAD, mesh)[0][1, 0]) / L - exact) for mesh in meshes]
    slope = -order(cells, errors)
    print(f"order {slope:.3f}")
    assert slope == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("turn", [0.5, 3.0])
def test_end_couple_bends_an_exact_arc(turn):
    """The couple turn EI/L winds the rod into an arc of that angle [rad]."""
    shape, y = static_shape(couple(turn * EI / L), FINE)
    angle = turn * np.linspace(1.0, 0.0, FINE.nodes)
    # From the clamp backwards; a positive couple on the tail's end turns it by +turn.
    arc = -L / turn * np.stack([np.sin(angle), 1.0 - np.cos(angle)])
    off = float(jnp.max(jnp.abs(shape - arc))) / L
    print(f"turn {turn} rad: largest distance from the arc {off:.2e} L")
    assert float(y[5, 0]) == pytest.approx(turn, rel=1e-9)
    assert off < 1e-3
