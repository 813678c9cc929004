"""Buckling loads of rods in space, from the stiffness matrix; 1 % of the theory's threshold."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.rod.ends import held_end
from slider_jax.rod.equilibrium import NEUTRAL, RodEquilibrium, equilibrium, smallest_eigenvalue
from slider_jax.rod.loads import RodLoads, straight_tendon, weighted_place
from slider_jax.rod.rod import Rod, half_cells, rod_shape
from slider_jax.rod.rotations import mean_rotation, rotation
from slider_jax.rod.virtual_work import rod_equations

POINTS = 80


def rod_of(length, GJ, EI_n, EI_b, points=POINTS):
    one = jnp.ones(points)
    stiffness = jnp.stack([GJ * one, EI_n * one, EI_b * one], axis=1)
    return Rod(length / points * one, stiffness, jnp.zeros((points, 3)), jnp.eye(3), 0.0 * one)


def loads_of(force=(0.0, 0.0, 0.0), moment=(0.0, 0.0, 0.0), follower=False):
    return RodLoads(
        jnp.array(force, float), jnp.array(moment, float), jnp.array([0.0, 0.0, -1.0]), (), follower
    )


def held_eigenvalue(rod, loads, strains, end):
    """Smallest eigenvalue of a known equilibrium with supports, which exert no forces here."""
    zero = jnp.zeros(3)
    shape = rod_shape(rod, strains)
    known = RodEquilibrium(strains, shape, zero, zero, zero[0], jnp.array(True), zero, zero)
    return smallest_eigenvalue(known, rod, loads, end)


def largest_error(strains, rod, loads):
    """Largest error [1/m] of a curvature in the equations."""
    work = rod_equations(strains, rod, loads).residual.reshape(strains.shape)
    return jnp.abs(work / (rod.elasticity * rod.ds[:, None])).max()


def changes_sign(eigenvalue_at, threshold):
    """Whether the eigenvalue is positive 1 % below the threshold and negative 1 % above it."""
    return eigenvalue_at(0.99 * threshold) > 0.0 > eigenvalue_at(1.01 * threshold)


@pytest.mark.slow
def test_a_strip_under_an_end_load_buckles_sideways():
    EI, GJ, L = 1e-3, 5e-4, 0.5
    rod = rod_of(L, GJ, EI, 1e4 * EI)

    def at(P):
        loads = loads_of(force=(0.0, P, 0.0))
        return smallest_eigenvalue(equilibrium(rod, loads, 4), rod, loads)

    assert changes_sign(at, 4.013 * np.sqrt(EI * GJ) / L**2)


@pytest.mark.slow
def test_a_column_buckles_at_eulers_load():
    rod = rod_of(0.4, 0.05, 0.03, 0.06)

    def at(P):
        loads = loads_of(force=(-P, 0.0, 0.0))
        return smallest_eigenvalue(equilibrium(rod, loads, 1), rod, loads)

    assert changes_sign(at, np.pi**2 * 0.03 / (4.0 * 0.4**2))


@pytest.mark.slow
@pytest.mark.parametrize("hinged, moment", [(False, 8.98682), (True, 2.0 * np.pi)])
def test_a_twisted_straight_rod_buckles_at_greenhills_moment(hinged, moment):
    EI, L = 0.03, 0.4
    rod = rod_of(L, 0.05, EI, EI)
    frame, along = None if hinged else np.eye(3), np.array([1.0, 0.0, 0.0])
    end = held_end(rod, L * along, frame, slides_along=along, near_hinge=hinged)

    def at(M):
        loads = loads_of(moment=(M, 0.0, 0.0))
        strains = rod.unloaded.at[:, 0].set(M / 0.05)
        assert largest_error(strains, rod, loads) < 1e-9
        return held_eigenvalue(rod, loads, strains, end)

    assert changes_sign(at, moment * EI / L)


@pytest.mark.slow
def test_a_twisted_ring_buckles_at_michells_angle():
    EI, GJ, R = 0.03, 0.02, 0.1
    L = 2.0 * np.pi * R
    rod = rod_of(L, GJ, EI, EI)

    def at(angle):
        twist = angle / L
        turned = twist * rod.s
        strains = jnp.stack(
            [jnp.full(POINTS, twist), jnp.sin(turned) / R, jnp.cos(turned) / R], axis=1
        )
        ahead = rod_shape(rod, strains).frame[-1][:, 0]
        moment = GJ * twist * ahead + jnp.array([0.0, 0.0, EI / R])
        loads = loads_of(force=(0.0, 0.0, GJ * twist / R), moment=moment)
        # The discrete ring is an equilibrium up to the error of second order in ds.
        assert largest_error(strains, rod, loads) < 0.02 / R
        tip = rod_shape(rod, strains)
        end = held_end(rod, np.asarray(tip.position[-1]), np.asarray(tip.frame[-1]))
        return held_eigenvalue(rod, loads, strains, end)

    assert changes_sign(at, 2.0 * np.pi * np.sqrt(3.0) * EI / GJ)


def test_the_eigenvalue_is_one_without_loads():
    rod = rod_of(0.4, 0.05, 0.03, 0.06)
    found = equilibrium(rod, loads_of(), 1)
    assert smallest_eigenvalue(found, rod, loads_of()) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("weight, neutral", [(0.0, True), (5.0, False)])
def test_a_pendulum_is_neutral_without_weight(weight, neutral):
    """A hanging straight rod between a hinge and an end that slides across; it turns rigidly."""
    rod, across = rod_of(0.4, 0.05, 0.03, 0.03, points=4), np.array([1.0, 0.0, 0.0])
    clamp = jnp.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
    rod = Rod(rod.ds, rod.stiffness, rod.initial_curvature, clamp, rod.weight + weight)
    end = held_end(rod, np.array([0.0, 0.0, -0.4]), None, slides_along=across, near_hinge=True)
    eigenvalue = held_eigenvalue(rod, loads_of(), rod.unloaded, end)
    assert abs(eigenvalue) <= NEUTRAL if neutral else eigenvalue > 0.01


@pytest.mark.slow
def test_derivatives_of_the_tip_agree_with_differences_in_forward_and_reverse():
    rod = rod_of(0.368, 0.05, 0.038, 0.152, points=20)
    loads = loads_of(force=(-0.2, 0.5, 0.5))

    def tip(scales):
        changed = Rod(rod.ds, rod.stiffness * scales, rod.initial_curvature, rod.clamp, rod.weight)
        return equilibrium(changed, loads, 4).shape.position[-1]

    one = jnp.ones(3)
    forward, reverse = jax.jacfwd(tip)(one), jax.jacrev(tip)(one)
    np.testing.assert_allclose(forward, reverse, atol=1e-12)
    step = 1e-4
    for i in range(3):
        d = step * jnp.eye(3)[i]
        np.testing.assert_allclose(
            forward[:, i], (tip(one + d) - tip(one - d)) / (2.0 * step), atol=1e-7
        )


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-3, 0.00999, 0.01001, 1.0, 3.0])
def test_rotations_against_integration(size):
    """The series for small angles and the closed forms, 1e-13."""
    v = size * np.array([0.48, -0.6, 0.64])
    steps = 200
    x, w = np.polynomial.legendre.leggauss(8)
    frame = np.asarray(rotation(v))
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-14)
    small = np.asarray(rotation(v / steps))
    np.testing.assert_allclose(np.linalg.matrix_power(small, steps), frame, atol=1e-12)
    mean = sum(
        0.5 * b * np.asarray(rotation(0.5 * (a + 1.0) * v)) for a, b in zip(x, w, strict=True)
    )
    np.testing.assert_allclose(mean_rotation(v), mean, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("follower", [False, True])
def test_residual_and_stiffness_are_derivatives_of_the_work(follower):
    """All loads at once, on a bent rod with unequal cells; automatic differentiation, 1e-12."""
    random = np.random.default_rng(0)
    edges = np.array([0.0, 0.1, 0.25, 0.3])

    def values(*shape):
        return jnp.asarray(random.uniform(0.5, 1.5, (6, *shape)))

    clamp = rotation(jnp.array([0.3, 0.2, 0.5]))
    ds = jnp.asarray(np.diff(half_cells(edges)))
    rod = Rod(ds, values(3), values(3), clamp, values(), 5.0 * values())
    tendon = straight_tendon((0.05, 0.22), (0.1, 0.05), (0.02, -0.1), 2.0, edges)
    force, moment, strains = random.normal(size=3), random.normal(size=3), values(4)
    down = jnp.array([0.0, 0.6, -0.8])
    loads = RodLoads(jnp.asarray(force), jnp.asarray(moment), down, (tendon,), follower)

    @jax.jit
    def work(q):
        """Energy, and the work of the loads on the tip, which keep their values at `strains`."""
        shape = rod_shape(rod, q)
        elastic = 0.5 * jnp.sum(rod.elasticity * (q - rod.unloaded) ** 2 * rod.ds[:, None])
        tip = rod_shape(rod, strains).frame[-1]
        F, M = loads.on_tip(tip, rod_shape(rod, rod.unloaded).frame[-1])
        turn = shape.frame[-1] @ tip.T
        turned = 0.5 * jnp.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0],
                                  turn[1, 0] - turn[0, 1]])  # fmt: skip
        potential = tendon.tension * tendon.length(rod, q) - weighted_place(rod, q, shape) @ down
        return elastic + potential - F @ shape.position[-1] - M @ turned

    equations = jax.jit(lambda q: rod_equations(q, rod, loads))
    found = equations(strains)
    np.testing.assert_allclose(found.residual, jax.grad(work)(strains).ravel(), atol=1e-12)
    matrix = jax.jit(jax.jacfwd(lambda q: equations(q).residual))(strains)
    np.testing.assert_allclose(found.stiffness, matrix.reshape(24, 24), atol=1e-12)
