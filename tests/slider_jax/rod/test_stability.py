"""Buckling loads of rods in space, from the stiffness matrix; 1 % of the theory's threshold."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import null_space

from slider_jax.rod.equilibrium import (
    equilibrium,
    smallest_eigenvalue,
    stiffness_matrix,
    virtual_work,
)
from slider_jax.rod.loads import RodLoads
from slider_jax.rod.rod import Rod, rod_shape
from slider_jax.rod.rotations import mean_rotation, rotation

CELLS = 80


def rod_of(length, GJ, EI_n, EI_b, cells=CELLS):
    one = jnp.ones(cells)
    stiffness = jnp.stack([GJ * one, EI_n * one, EI_b * one], axis=1)
    return Rod(length / cells * one, stiffness, jnp.zeros((cells, 3)), jnp.eye(3), 0.0 * one)


def loads_of(force=(0.0, 0.0, 0.0), moment=(0.0, 0.0, 0.0), follower=False):
    return RodLoads(
        jnp.array(force, float), jnp.array(moment, float), jnp.array([0.0, 0.0, -1.0]), (), follower
    )


@jax.jit
def _tip(rod, strains):
    shape = rod_shape(rod, strains)
    return shape.position[-1], shape.frame[-1]


_tip_slope, _stiffness = jax.jit(jax.jacfwd(_tip, argnums=1)), eqx.filter_jit(stiffness_matrix)


def held_eigenvalue(rod, loads, strains, held):
    """Smallest eigenvalue of the stiffness if the motions `held` of the tip are zero.

    `held` are the numbers of the tip's motions: displacements x, y, z and turns about x, y, z.
    """

    moved, turned = _tip_slope(rod, strains)
    frame = _tip(rod, strains)[1]
    spin = jnp.einsum("ijkl,mj->imkl", turned, frame)
    angle = jnp.stack([spin[2, 1], spin[0, 2], spin[1, 0]])
    motion = np.concatenate([moved, angle]).reshape(6, -1)[list(held)]
    free = null_space(motion)
    # `stiffness_matrix` is divided by the stiffness and ds of each strain.
    weights = np.asarray(rod.elasticity * rod.ds[:, None]).ravel()
    matrix = weights[:, None] * np.asarray(_stiffness(strains, rod, loads))
    reduced = free.T @ matrix @ free
    scale = np.linalg.inv(np.linalg.cholesky(free.T @ (weights[:, None] * free)))
    return np.linalg.eigvalsh(scale @ (0.5 * (reduced + reduced.T)) @ scale.T).min()


def changes_sign(eigenvalue_at, threshold):
    """Whether the eigenvalue is positive 1 % below the threshold and negative 1 % above it."""
    return eigenvalue_at(0.99 * threshold) > 0.0 > eigenvalue_at(1.01 * threshold)


@pytest.mark.slow
def test_a_strip_under_an_end_load_buckles_sideways():
    EI, GJ, L = 1e-3, 5e-4, 0.5
    rod = rod_of(L, GJ, EI, 1e4 * EI)

    def at(P):
        loads = loads_of(force=(0.0, P, 0.0))
        return smallest_eigenvalue(equilibrium(rod, loads, 4).strains, rod, loads)

    assert changes_sign(at, 4.013 * np.sqrt(EI * GJ) / L**2)


def test_a_column_buckles_at_eulers_load():
    rod = rod_of(0.4, 0.05, 0.03, 0.06)

    def at(P):
        loads = loads_of(force=(-P, 0.0, 0.0))
        return smallest_eigenvalue(rod.unloaded, rod, loads)

    assert changes_sign(at, np.pi**2 * 0.03 / (4.0 * 0.4**2))


@pytest.mark.slow
def test_a_twisted_straight_rod_between_clamps_buckles_at_greenhills_moment():
    EI, L = 0.03, 0.4
    rod = rod_of(L, 0.05, EI, EI)

    def at(M):
        loads = loads_of(moment=(M, 0.0, 0.0))
        strains = rod.unloaded.at[:, 0].set(M / 0.05)
        assert jnp.abs(virtual_work(strains, rod, loads)).max() < 1e-9
        return held_eigenvalue(rod, loads, strains, (1, 2, 4, 5))

    assert changes_sign(at, 8.98682 * EI / L)


@pytest.mark.slow
def test_a_twisted_ring_buckles_at_michells_angle():
    EI, GJ, R = 0.03, 0.02, 0.1
    L = 2.0 * np.pi * R
    rod = rod_of(L, GJ, EI, EI)

    def at(angle):
        twist = angle / L
        turned = twist * rod.s
        strains = jnp.stack(
            [jnp.full(CELLS, twist), jnp.sin(turned) / R, jnp.cos(turned) / R], axis=1
        )
        ahead = rod_shape(rod, strains).frame[-1][:, 0]
        moment = GJ * twist * ahead + jnp.array([0.0, 0.0, EI / R])
        loads = loads_of(force=(0.0, 0.0, GJ * twist / R), moment=moment)
        # The discrete ring is an equilibrium up to the error of second order in ds.
        assert jnp.abs(virtual_work(strains, rod, loads)).max() < 0.02 / R
        return held_eigenvalue(rod, loads, strains, range(6))

    assert changes_sign(at, 2.0 * np.pi * np.sqrt(3.0) * EI / GJ)


def test_the_eigenvalue_is_one_without_loads():
    rod = rod_of(0.4, 0.05, 0.03, 0.06)
    assert smallest_eigenvalue(rod.unloaded, rod, loads_of()) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.slow
def test_derivatives_of_the_tip_agree_with_differences_in_forward_and_reverse():
    rod = rod_of(0.368, 0.05, 0.038, 0.152, cells=20)
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
