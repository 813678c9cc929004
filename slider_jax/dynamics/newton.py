"""The root finder of an implicit stage, and its derivative by the implicit function theorem.

`BeamNewton` reads three options. `options["jacobian"]` is a function (y, args) -> BeamOperator.
`options["scale"]` is the scale of each unknown. If `options["skip"]` is true, the iteration stops
before its first step. A failed robot therefore adds no iterations to a batch.

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

from slider_jax.dynamics.block_solver import BeamSolver

ROUNDING = 1e-14
"""Increments below this size are rounding errors. They repeat with almost the same size, so their
ratio, close to 1, says nothing about the convergence: a straight robot that coasts has increments
of 3e-17, whose ratio differs from 1 by 1e-9."""


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

    Source: Shamanskii, V. E. (1967), A modification of Newton's method, Ukr. Math. J. 19, 118-122.
    """

    rtol: float
    atol: float = 0.0
    norm: Any = optx.max_norm
    corrections: int = 3
    linear_solver: BeamSolver = BeamSolver()

    def __check_init__(self):
        if self.corrections < 2 or self.atol != 0.0:
            raise ValueError(
                f"BeamNewton: given corrections={self.corrections}, atol={self.atol}; allowed "
                "corrections >= 2 (the last two steps give the convergence rate) and atol = 0"
            )

    def init(self, fn, y, args, options, f_struct, aux_struct, tags):
        return jnp.asarray(jnp.inf, y.dtype)

    def step(self, fn, y, args, options, state, tags):
        factors = self.linear_solver.init(options["jacobian"](y, args), {})

        def correct(_, carry):
            y, _, before = carry
            change, _, _ = self.linear_solver.compute(factors, fn(y, args)[0], {})
            size = self.norm(change / jnp.maximum(options["scale"], jnp.abs(y)))
            return y - change, before, size

        infinite = jnp.asarray(jnp.inf, y.dtype)
        y, before, last = jax.lax.fori_loop(0, self.corrections, correct, (y, infinite, infinite))
        rate = last / before
        shrinks = (rate < 1.0) & (last > ROUNDING)
        error = jnp.where(shrinks, last * rate / (1.0 - rate), last)
        return y, error, fn(y, args)[1]

    def terminate(self, fn, y, args, options, state, tags):
        bad = jnp.isnan(state)
        result = optx.RESULTS.where(bad, optx.RESULTS.nonfinite, optx.RESULTS.successful)
        return bad | (state < self.rtol) | options["skip"], result

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        return y, aux, {}


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
            y, rest = root(inputs)
            _, _, _, args, options, *_ = inputs
            t_value = tangent_of(lambda x: rewrite_fn(y, rest, x), inputs, t_inputs)
            factors = self.linear_solver.init(options["jacobian"](y, args), {})
            t_y, _, _ = self.linear_solver.compute(factors, t_value, {})
            t_rest = jax.tree.map(
                lambda x: jnp.zeros_like(x) if eqx.is_inexact_array(x) else None, rest
            )
            return (y, rest), (-t_y, t_rest)

        return root(inputs)
