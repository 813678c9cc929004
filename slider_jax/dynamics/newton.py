"""The root finder of an implicit stage, and its derivative by the implicit function theorem.

`BeamNewton` reads four options. `options["jacobian"]` is a function (y, args) -> BeamOperator.
`options["scale"]` is the scale of each unknown. If `options["skip"]` is true, the iteration stops
before its first step. A failed robot therefore adds no iterations to a batch. `options["error"]`
is the estimated error of the initial guess (default: infinite).

`BeamAdjoint` differentiates the root with the same Jacobian. If one robot of a batch fails, only
this robot's derivatives are invalid. Compiled programs do not call Python, so JAX can cache them.
"""

import functools as ft
from collections.abc import Callable
from typing import Any

import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
import optimistix as optx
from jax.ad_checkpoint import checkpoint_name
from jaxtyping import Array

from slider_jax.dynamics.block_solver import BeamOperator, BeamSolver

SOLUTION = "solution"
"""Name of a stage's solution, and of its statistics, for `jax.checkpoint`. A policy that saves this
name avoids a third search for the root in reverse mode."""
ROUNDING = 1e-14
"""Increments below this size are rounding errors. They repeat with almost the same size, so their
ratio, close to 1, says nothing about the convergence: a straight robot that coasts has increments
of 3e-17, whose ratio differs from 1 by 1e-9."""
REUSE_TOLERANCE = 1e-3
"""Factor on `rtol` for steps with the factors of another stage. The error is relative to the
scale of each unknown, but forces may be a hundred times smaller than their scale. With a factor of
1, such forces differed by 8e-8 of their size from the planar program."""


def tangent_of(function: Callable[[Any], Any], inputs: Any, tangents: Any) -> Any:
    """Returns the tangent of function(inputs); inputs whose tangent is None are constants."""
    moving = jax.tree.map(lambda t: t is not None, tangents, is_leaf=lambda t: t is None)
    dynamic, static = eqx.partition(inputs, moving)
    t_dynamic, _ = eqx.partition(tangents, moving)
    return jax.jvp(lambda d: function(eqx.combine(d, static)), (dynamic,), (t_dynamic,))[1]


class BeamNewton(optx.AbstractRootFinder):
    """Shamanskii's method: one factorisation per iteration and several simplified Newton steps.

    Each iteration makes `corrections` (at least 2) steps with the same factors. Each increment
    is about r times the previous increment. The error after the last step is therefore about
    |increment| r/(1 - r). The iteration stops when this error, divided by max(`options["scale"]`,
    |y|), is below `rtol`. `atol` must be 0, since the six unknowns have different units.

    `max_reused` is the largest number of steps with the factors of another stage.

    Source: Shamanskii, V. E. (1967), A modification of Newton's method, Ukr. Math. J. 19, 118-122.
    """

    rtol: float
    atol: float = 0.0
    norm: Any = optx.max_norm
    corrections: int = 3
    max_reused: int = 8
    linear_solver: BeamSolver = BeamSolver(differentiable=False)

    def __check_init__(self):
        few = min(self.corrections, self.max_reused) < 2
        if few or self.atol != 0.0 or self.norm is not optx.max_norm:
            raise ValueError(
                f"BeamNewton: given corrections={self.corrections}, max_reused={self.max_reused}, "
                f"atol={self.atol}, norm={self.norm}; allowed corrections and max_reused >= 2 (the "
                "last two steps give the convergence rate), atol = 0 and norm = optx.max_norm"
            )

    def init(self, fn, y, args, options, f_struct, aux_struct, tags):
        return options.get("error", jnp.asarray(jnp.inf, y.dtype))

    def step(self, fn, y, args, options, state, tags):
        factors = self.factors(options["jacobian"], y, args)

        def residual(y):
            return fn(y, args)[0]

        def correct(_, values):
            return self._simplified_step(residual, factors, options["scale"], values)

        y, sizes = jax.lax.fori_loop(0, self.corrections, correct, (y, _no_steps(y)))
        return y, _error(*sizes), fn(y, args)[1]

    def terminate(self, fn, y, args, options, state, tags):
        bad = jnp.isnan(state)
        result = optx.RESULTS.where(bad, optx.RESULTS.nonfinite, optx.RESULTS.successful)
        return bad | (state < self.rtol) | options["skip"], result

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        return y, aux, {}

    def factors(self, jacobian: Callable[[Any, Any], BeamOperator], y, args) -> Any:
        """Returns the factors of jacobian(y, args), without derivatives."""
        factors, _ = self.linear_solver.init(jacobian(*jax.lax.stop_gradient((y, args))), {})
        return factors

    def guess_with_factors(self, fn, guess, args, factors, scale, usable) -> tuple[Any, Any]:
        """Returns a better guess by steps with the `factors` of another stage, and its error.

        The steps stop when the estimated error is below max(`REUSE_TOLERANCE` `rtol`, `ROUNDING`).
        If the error is still larger after `max_reused` steps, or if the factors are not `usable`,
        the method returns `guess` and an infinite error.
        Derivatives of the root do not depend on the guess, so the steps are not differentiated.
        """
        guess, args, factors, scale = jax.lax.stop_gradient((guess, args, factors, scale))
        limit = max(REUSE_TOLERANCE * self.rtol, ROUNDING)

        def better(values):
            return self._simplified_step(lambda y: fn(y, args), factors, scale, values)

        def unfinished(state):
            count, (_, sizes) = state
            return usable & (count < self.max_reused) & (_error(*sizes) >= limit)

        # Every stage needs the first steps. Without a condition, a batch computes them faster.
        first = jax.lax.fori_loop(
            0, self.corrections, lambda _, values: better(values), (guess, _no_steps(guess))
        )
        start = self.corrections, first
        _, (y, sizes) = jax.lax.while_loop(
            unfinished, lambda state: (state[0] + 1, better(state[1])), start
        )
        error = _error(*sizes)
        found = usable & (error < limit)
        return jnp.where(found, y, guess), jnp.where(found, error, jnp.inf)

    def solve_stage(self, fn, jacobian, guess, args, factors, scale, ok, most) -> optx.Solution:
        """Returns the root of `fn`, found with the `factors` of another stage if they suffice.

        Otherwise, up to `most` iterations follow. A robot that is not `ok` keeps its guess.
        """
        guess, error = self.guess_with_factors(fn, guess, args, factors, scale, ok)
        return optx.root_find(
            fn,
            self,
            guess,
            args=args,
            options={"jacobian": jacobian, "scale": scale, "skip": ~ok, "error": error},
            max_steps=most,
            adjoint=BeamAdjoint(),
            throw=False,
        )

    def _simplified_step(self, residual, factors, scale, values):
        """Returns y after one more step with the factors, and the sizes of the last two steps."""
        y, sizes = values
        return self.linear_solver.correct(factors, residual(y), scale, y, sizes)


def _no_steps(y) -> Array:
    """Returns the sizes (2,) of the last two steps before the first step: infinite."""
    return jnp.full(2, jnp.inf, y.dtype)


def _error(before, last):
    """Returns the estimated error after steps of the given sizes; one step gives no estimate."""
    rate = last / before
    shrinks = (rate < 1.0) & (last > ROUNDING)
    error = jnp.where(shrinks, last * rate / (1.0 - rate), last)
    return jnp.where(jnp.isinf(before) & ~jnp.isnan(last), before, error)


class BeamAdjoint(optx.AbstractAdjoint):
    """Computes dy = -J^-1 df for the root y of f(y, args) = 0, with the Jacobian J = df/dy at y.

    One factorisation of J serves all forward tangents. Reverse mode transposes this linear map.
    """

    linear_solver: BeamSolver = BeamSolver()

    def apply(self, primal_fn, rewrite_fn, inputs, tags):
        inputs = (*inputs, ft.partial(eqxi.while_loop, kind="lax"))

        @eqx.filter_custom_jvp
        def root(inputs):
            return primal_fn(inputs)

        @root.def_jvp
        def root_jvp(primals, tangents):
            (inputs,), (t_inputs,) = primals, tangents
            y, rest = checkpoint_name(root(inputs), SOLUTION)
            _, _, _, args, options, *_ = inputs
            t_value = tangent_of(lambda x: rewrite_fn(y, rest, x), inputs, t_inputs)
            factors = self.linear_solver.init(options["jacobian"](y, args), {})
            t_y, _, _ = self.linear_solver.compute(factors, t_value, {})
            t_rest = jax.tree.map(
                lambda x: jnp.zeros_like(x) if eqx.is_inexact_array(x) else None, rest
            )
            return (y, rest), (-t_y, t_rest)

        return root(inputs)
