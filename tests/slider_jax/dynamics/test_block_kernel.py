"""The compiled solver against its twin in JAX, and machines without a compiler."""

import logging

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.beam.parameters import Numerics, scales_of
from slider_jax.channels import SLIDER_CHANNELS
from slider_jax.dynamics import block_kernel
from slider_jax.dynamics.block_solver import BeamOperator, BeamSolver
from slider_jax.dynamics.model import make_mesh
from slider_jax.dynamics.residual import jacobian
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.observables import chamber_power
from tests.support.helpers import SMALL, stage_of, swimmer

TWIN, KERNEL = BeamSolver(compiled=False), BeamSolver(compiled=True)


@pytest.fixture(autouse=True, scope="module")
def compiled():
    why = block_kernel.why_unavailable()
    if why is not None and "no C++ compiler" in why:
        pytest.skip(why)
    assert why is None, why


def operators(k, cells, robots, seed=0):
    """Operators of bodies with a strong diagonal, as the rows of a beam have, and right sides."""
    rng = np.random.default_rng(seed)
    left, right = 0.1 * rng.normal(size=(2, robots, 2 * k, 2 * k, cells))
    ahead = np.concatenate([np.arange(k, 2 * k), np.arange(k)])
    left[:, np.arange(2 * k), ahead] -= 3.0
    right[:, np.arange(2 * k), ahead] += 3.0
    tail, head = 0.1 * rng.normal(size=(2, robots, k, 2 * k))
    tail[:, np.arange(k), np.arange(k)] += 1.0
    head[:, np.arange(k), np.arange(k, 2 * k)] += 1.0
    rhs = [rng.normal(size=(robots, *shape)) for shape in ((2 * k, cells), (k,), (k,))]
    parts = map(jnp.asarray, (left, right, tail, head))
    return BeamOperator(*parts), tuple(map(jnp.asarray, rhs))


def solutions(solver):
    """A function that returns the solutions of A y = rhs and of A^T r = (a vector made of rhs)."""

    def solve(operator, rhs):
        factors = solver.init(operator, {})
        y, _, _ = solver.compute(factors, rhs, {})
        back, _, _ = solver.compute(solver.transpose(factors, {})[0], jnp.cos(y), {})
        return y, back

    return jax.jit(jax.vmap(solve))


def close(found, exact, within=1e-12):
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(exact), strict=True):
        assert np.max(np.abs(a - b)) < within * np.max(np.abs(b))


@pytest.mark.parametrize("robots", [1, 11])
@pytest.mark.parametrize(("k", "cells"), [(3, 1), (3, 7), (3, 8), (3, 37), (6, 3), (6, 9)])
def test_solution_and_transposed_solution_equal_those_of_the_twin(k, cells, robots):
    """With 11 robots, 8 are factorised together and 3 one by one."""
    operator, rhs = operators(k, cells, robots)
    close(solutions(KERNEL)(operator, rhs), solutions(TWIN)(operator, rhs))


@pytest.mark.slow
@pytest.mark.parametrize("k", [3, 6])
def test_derivatives_equal_those_of_the_twin(k):
    """Forward and reverse, with respect to the operator and to the right side."""
    operator, rhs = jax.tree.map(lambda x: x[0], operators(k, 10, 1))
    change = jax.tree.map(lambda x: jnp.sin(1.0 + 3.0 * x), (operator, rhs))

    def value_and_derivatives(solver):
        def solve(operator, rhs):
            return solver.compute(solver.init(operator, {}), rhs, {})[0]

        def weighted(operator, rhs):
            return jnp.sum(jnp.sin(solve(operator, rhs)))

        forward = jax.jvp(solve, (operator, rhs), change)
        return forward, jax.grad(weighted, argnums=(0, 1))(operator, rhs)

    close(
        jax.jit(lambda: value_and_derivatives(KERNEL))(),
        jax.jit(lambda: value_and_derivatives(TWIN))(),
    )


def test_one_factorisation_serves_several_right_sides():
    """The factors are not batched, or batched along another axis than the right side."""
    operator, rhs = operators(3, 12, 5)
    many = jax.tree.map(lambda x: jnp.stack([x, 2.0 * x, x**2], axis=1), rhs)

    def solve(solver):
        def one(operator, rhs):
            factors = solver.init(operator, {})
            return jax.vmap(lambda r: solver.compute(factors, r, {})[0])(rhs)

        return jax.jit(jax.vmap(one))(operator, many)

    close(solve(KERNEL), solve(TWIN))


@pytest.mark.parametrize("robot", [4, 9])
def test_nan_in_one_robot_leaves_the_others_unchanged_to_the_bit(robot):
    """Robot 4 is factorised in a group, robot 9 alone."""
    operator, rhs = operators(3, 12, 11)
    ill = eqx.tree_at(lambda a: a.left, operator, operator.left.at[robot, 2, 1, 3].set(jnp.nan))
    found, well = solutions(KERNEL)(ill, rhs), solutions(KERNEL)(operator, rhs)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(well), strict=True):
        assert not np.isfinite(a[robot]).all()
        np.testing.assert_array_equal(np.delete(a, robot, 0), np.delete(b, robot, 0))


@pytest.mark.parametrize("tail", [{}, {"EI_tail": 0.006, "EA_tail": 8e4}])
def test_the_stage_of_a_robot_is_solved_as_accurately_as_with_the_twin(tail):
    """The residual of the solution, in a short time step: with the built-in tail, and a sheet."""
    model = swimmer(**tail)
    mesh = make_mesh(model.body, Numerics(6, 24))
    y = 1e-2 * jnp.cos(jnp.arange(186.0)).reshape(6, 31) * scales_of(model.body)
    operator = jacobian(y, stage_of(model, Numerics(6, 24), 0.9 * y, 1e-4))
    rhs = operator.mv(y * jnp.sin(1.0 + mesh.grid.s))

    def error(solver):
        solution, _, _ = solver.compute(solver.init(operator, {}), rhs, {})
        left = jax.tree.map(lambda a, b: jnp.max(jnp.abs(a - b)), operator.mv(solution), rhs)
        return max(map(float, left)) / float(max(jnp.max(jnp.abs(x)) for x in rhs))

    assert error(KERNEL) < 10.0 * error(TWIN) < 1e-11


@pytest.mark.parametrize(("k", "cells"), [(3, 1), (3, 7), (3, 15), (6, 9)])
def test_a_step_of_newtons_method_equals_that_of_the_twin(k, cells):
    """The largest relative change is NaN if a change is not finite."""
    operator, rhs = operators(k, cells, 6)
    scale, y = jnp.linspace(0.1, 2.0, 2 * k)[:, None], jnp.cos(jnp.arange(12.0 * k * (cells + 1)))
    y, before = y.reshape(6, 2 * k, cells + 1), jnp.arange(12.0).reshape(6, 2)
    steps = BeamSolver(compiled=True, differentiable=False)

    def step(solver):
        def one(operator, rhs, y, sizes):
            return solver.correct(solver.init(operator, {})[0], rhs, scale, y, sizes)

        return jax.jit(jax.vmap(one))

    close(step(steps)(operator, rhs, y, before), step(TWIN)(operator, rhs, y, before))
    for solver in (steps, TWIN):
        ill = rhs[0].at[1, 0, 0].set(jnp.nan), *rhs[1:]
        _, sizes = step(solver)(operator, ill, y, before)
        np.testing.assert_array_equal(sizes[:, 0], before[:, 1])
        assert np.isnan(sizes[:, 1]).tolist() == [False, True, False, False, False, False]


def test_steps_in_a_loop_leave_their_first_guess_unchanged():
    """The library writes its result over its input; the loop begins with one guess for all."""
    operator, rhs = operators(3, 9, 6)
    scale, guess = jnp.ones((6, 1)), jnp.cos(jnp.arange(60.0)).reshape(6, 10)

    def steps(solver):
        def one(operator, rhs):
            factors, _ = solver.init(operator, {})

            def step(_, values):
                y, sizes = values
                less = jax.tree.map(lambda a, b: 0.9 * a - b, operator.mv(y), rhs)
                return solver.correct(factors, less, scale, y, sizes)

            last = jax.lax.fori_loop(0, 3, step, (guess, jnp.full(2, jnp.inf)))
            return *last, last[0] - guess

        return jax.jit(jax.vmap(one))(operator, rhs)

    close(steps(BeamSolver(compiled=True, differentiable=False)), steps(TWIN))


@pytest.mark.parametrize(
    ("compiler", "why"),
    [
        ("", "no C++ compiler was found"),
        ("no_such_compiler", "no_such_compiler"),
        ("false", "compiler false failed: exit status 1"),
    ],
)
def test_without_a_working_compiler_one_line_says_why(compiler, why, monkeypatch, tmp_path, caplog):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("CXX", compiler)
    if not compiler:
        monkeypatch.setattr("shutil.which", lambda name: None)
    with caplog.at_level(logging.WARNING):
        assert why in block_kernel.why_unavailable.__wrapped__()
    assert len(caplog.records) == 1 and "twice as long" in caplog.text
    assert not list(tmp_path.rglob("*.so*"))


def test_a_damaged_library_is_built_again(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    path = tmp_path / "slider_jax" / f"block_kernel-{block_kernel.library_digest()}.so"
    path.parent.mkdir()
    path.write_bytes(b"")
    assert not isinstance(block_kernel._load(), str)
    assert path.stat().st_size > 10_000


def test_a_cache_folder_that_cannot_be_written_is_not_needed(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert not isinstance(block_kernel._load(), str)


def test_the_compiled_solver_is_refused_for_float32():
    operator, rhs = jax.tree.map(lambda x: x[0].astype(jnp.float32), operators(3, 4, 1))
    with pytest.raises(ValueError, match="given float32"):
        KERNEL.init(operator, {})


@pytest.mark.parametrize("robots", [1, 9])
def test_a_simulation_equals_that_with_the_twin(monkeypatch, robots):
    """Readings and power of two strides, and the forward derivatives with respect to C_d."""
    assert block_kernel.is_used()
    times = TimeGrid.per_stride(4.8, 40, 2)

    def simulated(C_d):
        def readings(x):
            return SLIDER_CHANNELS.observe(x) | {"power": jnp.sum(chamber_power(x))}

        def run(C_d):
            out = rollout(swimmer(C_d=C_d), times, readings, SMALL)
            return out.saved, out.ok

        return jax.jvp(run, (C_d,), (jnp.ones_like(C_d),), has_aux=True)

    C_d = jnp.linspace(2.0, 4.0, robots)
    calls = []

    def twin_is_used():
        calls.append(1)
        return False

    *kernel, ok = jax.jit(jax.vmap(lambda x: simulated(x)))(C_d)
    monkeypatch.setattr(block_kernel, "is_used", twin_is_used)
    jax.clear_caches()  # else JAX reuses the traced solver
    *twin, also_ok = jax.jit(jax.vmap(lambda x: simulated(x)))(C_d)
    jax.clear_caches()
    assert calls and ok.all() and also_ok.all()
    for found, exact in zip(kernel, twin, strict=True):
        for name, series in exact.items():
            error = jnp.max(jnp.abs(found[name] - series))
            assert error <= 1e-10 * jnp.max(jnp.abs(series)), name
