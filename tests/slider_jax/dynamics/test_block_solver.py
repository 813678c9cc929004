"""The structured Jacobian and its solve against their dense twins, for every support and parity."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest

from slider_jax.beam.parameters import Numerics, scales_of
from slider_jax.dynamics.block_solver import BeamSolver
from slider_jax.dynamics.newton import BeamAdjoint, BeamNewton
from slider_jax.dynamics.residual import jacobian, residual
from slider_jax.effects import Gravity
from slider_jax.supports import Clamped, Free, PinnedLink
from tests.support.helpers import flat_residual, stage_of, swimmer

SUPPORTS = {
    "clamped": Clamped(tow_speed=0.3, heave=0.01, pitch=0.1, frequency=2.0),
    "free": Free(),
    "pinned": PinnedLink(link_length=0.03, frequency=2.0),
}
SIZES = {
    "even": Numerics(tail_cells=2, body_cells=6),
    "odd": Numerics(tail_cells=2, body_cells=5),
    "51 nodes": Numerics(tail_cells=10, body_cells=40),
}


def bent(nodes, seed=0):
    """A smooth state of full size: forces of about 1 N, speeds of 0.3 m/s, a bend of 1 rad."""
    rng = np.random.default_rng(seed)
    size = np.array([1.0, 0.5, 0.05, 0.3, 0.3, 1.0])[:, None, None]
    waves = np.cos(np.pi * np.arange(4)[:, None] * np.linspace(0.0, 1.0, nodes))
    return jnp.asarray((size * rng.normal(size=(6, 4, 1)) * waves).sum(axis=1) * 0.5)


def problem(support, numerics, dt=5e-4):
    model = swimmer(support=SUPPORTS[support])
    model = eqx.tree_at(lambda m: m.effects, model, (*model.effects, Gravity(9.81)))
    y = bent(numerics.nodes)
    active = jnp.full((numerics.nodes - 1,), 0.1)
    return y, stage_of(model, numerics, 0.9 * bent(numerics.nodes, 1), dt, 0.03, active)


def dense_jacobian(y, stage):
    return jax.jacfwd(lambda v: flat_residual(v.reshape(y.shape), stage))(y.ravel())


def flat(rhs):
    return jnp.concatenate([part.ravel() for part in rhs])


@jax.jit
def structured(operator, rhs, y):
    """The matrix, the solution of J x = rhs, and that of J^T r = y, as flat vectors."""
    solver = BeamSolver()
    factors = solver.init(operator, {})
    found, _, _ = solver.compute(factors, rhs, {})
    back, _, _ = solver.compute(solver.transpose(factors, {})[0], y, {})
    return operator.as_matrix(), found.ravel(), flat(back)


@pytest.mark.parametrize(
    "size", ["even", *(pytest.param(x, marks=pytest.mark.slow) for x in ("odd", "51 nodes"))]
)
@pytest.mark.parametrize("support", SUPPORTS)
def test_jacobian_solve_and_transposed_solve_match_the_dense_twin(support, size):
    y, stage = problem(support, SIZES[size])
    rhs, operator, dense = jax.jit(
        lambda y, s: (residual(y, s), jacobian(y, s), dense_jacobian(y, s))
    )(y, stage)
    matrix, found, back = structured(operator, rhs, y)
    assert float(jnp.max(jnp.abs(matrix - dense) / (1.0 + jnp.abs(dense)))) < 1e-12

    exact = np.linalg.solve(dense, flat(rhs))
    exact_back = np.linalg.solve(dense.T, y.ravel())
    off = np.max(np.abs(found - exact)) / np.max(np.abs(exact))
    off_back = np.max(np.abs(back - exact_back)) / np.max(np.abs(exact_back))
    print(f"{support}, {size}: solve off {off:.1e}, transposed {off_back:.1e}")
    assert off < 1e-9 and off_back < 1e-9


@pytest.mark.parametrize(
    "support",
    [
        pytest.param("pinned", marks=pytest.mark.slow),
        pytest.param("clamped", marks=pytest.mark.slow),
        pytest.param("free", marks=pytest.mark.slow),
    ],
)
def test_derivative_of_a_root_matches_the_dense_implicit_one(support):
    """dy/dtheta = -J^-1 dR/dtheta, forward and reverse, theta scaling the moment, EI and water."""
    numerics = SIZES["odd"]
    _, stage = problem(support, numerics, dt=1e-3)
    model = swimmer(support=SUPPORTS[support])
    stage = eqx.tree_at(lambda s: s.effects, stage, model.effects)
    y0 = jnp.zeros((6, numerics.nodes))
    still = stage_of(model, numerics, y0, 1e-3, 0.0, stage.active_moment)
    scale = scales_of(model.robot)

    def moved(theta):
        return eqx.tree_at(
            lambda s: (s.active_moment, s.structure.EI, s.water),
            still,
            (
                still.active_moment * theta[0],
                still.structure.EI * theta[1],
                theta[2] * jnp.array([[0.1, 0.2], [0.0, 0.0]]),
            ),
            is_leaf=lambda x: x is None,
        )

    def root(theta):
        return optx.root_find(
            residual,
            BeamNewton(rtol=1e-9),
            y0,
            args=moved(theta),
            options={"jacobian": jacobian, "scale": scale, "skip": jnp.asarray(False)},
            max_steps=30,
            adjoint=BeamAdjoint(),
        ).value

    theta = jnp.ones(3)
    weight = bent(numerics.nodes, 2)
    (_, y), reverse = jax.jit(
        jax.value_and_grad(lambda p: (jnp.sum(weight * (y := root(p))), y), has_aux=True)
    )(theta)
    forward = jax.jit(jax.jacfwd(root))(theta).reshape(-1, 3)

    @jax.jit
    def dense(y, theta):
        stage = moved(theta)
        value = flat_residual(y, stage)
        by_theta = jax.jacfwd(lambda p: flat_residual(y, moved(p)))(theta)
        return value, -jnp.linalg.solve(dense_jacobian(y, stage), by_theta)

    value, exact = dense(y, theta)
    assert float(jnp.max(jnp.abs(value))) < 1e-7
    np.testing.assert_allclose(forward, exact, rtol=1e-8, atol=1e-9 * np.abs(exact).max())
    np.testing.assert_allclose(reverse, weight.ravel() @ exact, rtol=1e-8)


def test_steps_with_the_factors_of_another_stage_find_the_root_or_keep_the_guess():
    """Steps with the factors of a problem with a 5 % larger moment converge. With factors for a
    hundred times the EI, they do not converge, and the guess is returned."""
    _, stage = problem("clamped", SIZES["even"], dt=1e-3)
    guess, scale = 0.0 * bent(SIZES["even"].nodes), scales_of(swimmer().robot)
    solver, exactly = BeamNewton(rtol=1e-9), BeamNewton(rtol=1e-12)

    @functools.partial(jax.jit, static_argnums=0)
    def root(solver, guess, error):
        options = {"jacobian": jacobian, "scale": scale, "skip": jnp.asarray(False), "error": error}
        return optx.root_find(
            residual, solver, guess, args=stage, options=options, max_steps=30,
            adjoint=BeamAdjoint(),
        )  # fmt: skip

    exact = root(exactly, guess, jnp.asarray(jnp.inf)).value

    @jax.jit
    def with_factors_of(other, usable):
        factors = solver.factors(jacobian, exact, other)
        return solver.guess_with_factors(residual, guess, stage, factors, scale, usable)

    near = eqx.tree_at(lambda s: s.active_moment, stage, 1.05 * stage.active_moment)
    far = eqx.tree_at(lambda s: s.structure.EI, stage, 100.0 * stage.structure.EI)
    found, error = with_factors_of(near, jnp.asarray(True))
    assert error < 1e-12
    assert np.max(np.abs(found - exact) / np.maximum(scale, np.abs(exact))) < 1e-9
    assert root(solver, found, error).stats["num_steps"] == 0
    for other, usable in ((far, True), (near, False)):
        kept, error = with_factors_of(other, jnp.asarray(usable))
        assert error == jnp.inf and np.array_equal(kept, guess)
