"""The root finder of an implicit stage, and its derivative by the implicit function theorem.

`BeamNewton` is Newton's method with the Jacobian's blocks, handed to `optimistix.root_find` through
`options["jacobian"]`, a function (y, args) -> BeamOperator. `BeamAdjoint` differentiates the root with
the same blocks; a member of a batch that failed spoils its own derivative only, and nothing in here
calls back to the host, so compiled programs can be cached.
"""

import functools as ft
from typing import Any

import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array

from slider_jax.linear import BeamSolver


class _NewtonState(eqx.Module):
    increment: Array
    steps: Array


class BeamNewton(optx.AbstractRootFinder):
    """Newton's method; stops when the last increment, over `options["scale"]`, is below `rtol`.

    Newton converges quadratically, so the error that remains is about the square of that increment.
    """

    rtol: float
    atol: float = 0.0
    norm: Any = optx.max_norm
    linear_solver: BeamSolver = BeamSolver()

    def init(self, fn, y, args, options, f_struct, aux_struct, tags):
        return _NewtonState(jnp.asarray(jnp.inf, y.dtype), jnp.asarray(0))

    def step(self, fn, y, args, options, state, tags):
        value, aux = fn(y, args)
        factors = self.linear_solver.init(options["jacobian"](y, args), {})
        change, _, _ = self.linear_solver.compute(factors, value, {})
        size = self.norm(change / jnp.maximum(options["scale"], jnp.abs(y)))
        return y - change, _NewtonState(size, state.steps + 1), aux

    def terminate(self, fn, y, args, options, state, tags):
        bad = jnp.isnan(state.increment)
        result = optx.RESULTS.where(bad, optx.RESULTS.nonfinite, optx.RESULTS.successful)
        return bad | (state.increment < self.rtol), result

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        return y, aux, {}


class BeamAdjoint(optx.AbstractAdjoint):
    """Derivative of the root y of f(y, args) = 0: dy = -J(y)^-1 df, J factorised once per root.

    Forward tangents share the factorisation; reverse mode transposes the same solve.
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
            moving = jax.tree.map(
                lambda t: t is not None, t_inputs, is_leaf=lambda t: t is None
            )
            dynamic, static = eqx.partition(inputs, moving)
            t_dynamic, _ = eqx.partition(t_inputs, moving)

            def value(dynamic):
                return rewrite_fn(y, rest, eqx.combine(dynamic, static))

            _, t_value = jax.jvp(value, (dynamic,), (t_dynamic,))
            factors = self.linear_solver.init(options["jacobian"](y, args), {})
            t_y, _, _ = self.linear_solver.compute(factors, t_value, {})
            t_rest = jax.tree.map(
                lambda x: jnp.zeros_like(x) if eqx.is_inexact_array(x) else None, rest
            )
            return (y, rest), (-t_y, t_rest)

        return root(inputs)
