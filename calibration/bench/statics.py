"""Fits stiffness and moment per pressure to the static shapes in all tables of a bench together.

The model is the beam of `slider simulate`. Every table has an offset: the reading of its ruler at
zero displacement. Tip loads identify the bending stiffness EI, and pressures identify the moment
per pressure K_Q. The interval of K_Q includes the uncertainty of EI.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import least_squares

from calibration.bench.tables import Bench, Shapes
from calibration.inference.gauss_newton import inverse
from calibration.inference.intervals import student_quantile
from slider_jax.actuation import Ideal, SineWave
from slider_jax.beam.parameters import Numerics, Robot
from slider_jax.dynamics.model import Drive, Model
from slider_jax.dynamics.statics import Loads, at_rest_under
from slider_jax.errors import InputError
from slider_jax.supports import Clamped

UNITS = {"EI_body": "N m^2", "EI_tail": "N m^2", "K_Q": "m^3", "damping_time": "s"}
DETERMINED = 0.5
"""A parameter is determined if its interval's half width is below this fraction of its value."""
FIRST_NOISE = 1e-3
"""First estimate [m] of a table's undeclared noise. The second fit uses the residual's noise."""
Linearised = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Maps x (k,) to the residual (n,), divided by the noise, and the residual's derivative (n, k)."""


class Minimum(NamedTuple):
    """Parameters x (k,) that minimise a sum of squares, and the residual (n,) at the minimum."""

    x: np.ndarray
    residual: np.ndarray
    inverse: np.ndarray
    """Inverse of the normal matrix (k, k): the covariance of x if the assumed noise is correct."""
    converged: bool


def levenberg_marquardt(linearised: Linearised, start: np.ndarray) -> Minimum:
    """Returns the minimum near `start`, from MINPACK's Levenberg-Marquardt method.

    Raises `InputError` if the model has no solution at the start.
    """
    first = linearised(start)
    if not np.isfinite(first[0]).all():
        raise InputError(
            "the model has no solution for the loads of this file at the given stiffness; check "
            "loads, stiffness and units"
        )
    known = {start.tobytes(): first}

    def at(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        key = x.tobytes()
        if key not in known:
            known.clear()
            residual, slope = linearised(x)
            known[key] = (np.nan_to_num(residual, nan=1e6, posinf=1e6, neginf=-1e6), slope)
        return known[key]

    found = least_squares(
        lambda x: at(x)[0], start, lambda x: at(x)[1], method="lm", x_scale="jac", max_nfev=60
    )
    residual, slope = at(found.x)
    return Minimum(found.x, residual, inverse(slope.T @ slope), found.status > 0)


class BenchEstimate(NamedTuple):
    """A parameter with its 95 % interval, in SI units."""

    value: float
    low: float
    high: float

    @classmethod
    def of(cls, value: float, error: float, times: float) -> "BenchEstimate":
        """Returns `value` with the interval from value - times x error to value + times x error.

        `error` is the standard error. The lower limit is at least 0.
        """
        return cls(value, max(0.0, value - times * error), value + times * error)

    @property
    def determined(self) -> bool:
        return self.high - self.value < DETERMINED * self.value


class ShapeFit(NamedTuple):
    """The fit of the static shapes."""

    parameters: dict[str, BenchEstimate]
    correlations: np.ndarray
    """Correlations of the parameters, in the order of `parameters`."""
    predicted: list[np.ndarray]
    """Predicted tip of every table, followed by the joint if the joint was measured [m]."""
    noise: list[float]
    """Standard deviation of the noise in every table [m]."""
    offsets: list[float]
    """Reading of every table's ruler at zero displacement [m]."""
    mean_square: float
    """Mean square of the residual divided by the noise; NaN if a table declares no noise."""
    converged: bool


def undriven_robot(robot: Robot) -> Model:
    """Returns the model of a clamped robot in air without drive."""
    still = SineWave(1.0, 0.0)
    return Model(robot, (), Ideal(), Drive((still,) * len(robot.chambers)), Clamped())


def tail_alone(robot: Robot) -> Robot:
    """Returns the tail as a separate robot on the same mesh."""
    return replace(
        robot,
        body=replace(robot.tail, lengths=0.8 * robot.tail.lengths),
        tail=replace(robot.tail, lengths=0.2 * robot.tail.lengths),
    )


def given_values(robot: Robot) -> dict[str, float]:
    """Returns the robot's values of the parameters in `UNITS`."""
    parts = robot.body.effective_EI, robot.tail.effective_EI
    values = *parts, robot.K_Q, robot.body.damping_time
    return {name: float(x) for name, x in zip(UNITS, values, strict=True)}


@eqx.filter_jit
def _shapes(logs: Float[Array, "3"], robot: Robot, rows, numerics: Numerics):
    """Returns the displacements of tip and joint (2, rows) [m], and their derivatives.

    The derivatives (2, rows, 3) are with respect to `logs`.
    `logs` are the logarithms of EI_body, EI_tail and K_Q. `rows` contains on_tail (rows,), force
    (rows,) and pressure (rows, chambers), as in `Shapes`.
    """

    def displacements(logs):
        EI_body, EI_tail, K_Q = jnp.exp(logs)
        whole = replace(robot, K_Q=K_Q, body=robot.body.changed(EI=EI_body)).with_tail(EI=EI_tail)

        def one(on_tail, force, pressure):
            chosen = jax.tree.map(lambda a, b: jnp.where(on_tail, a, b), tail_alone(whole), whole)
            loads = Loads(jnp.stack([jnp.zeros_like(force), force]), pressure)
            found = at_rest_under(undriven_robot(chosen), loads, numerics)
            both = jnp.stack([found.shape[1, 0], found.shape[1, numerics.tail_cells]])
            return jnp.where(found.ok, both, jnp.nan)

        return jax.vmap(one, out_axes=1)(*rows)

    slopes = jax.vmap(lambda d: jax.jvp(displacements, (logs,), (d,)), out_axes=(None, -1))
    return slopes(jnp.eye(3))


def identifiable_parameters(shapes: Sequence[Shapes]) -> list[str]:
    """Returns the names of the parameters that can be identified from the tables `shapes`.

    The tip's displacement under a load on the whole robot identifies only one stiffness, EI_body.
    EI_tail needs the joint's displacement, or a table for the tail alone.
    """
    loads = [x for x in shapes if x.kind == "tip_load"]
    names = []
    if any(not x.on_tail for x in loads):
        names.append("EI_body")
    if any(x.on_tail or x.joint is not None for x in loads):
        names.append("EI_tail")
    if any(x.kind == "pressure" for x in shapes):
        names.append("K_Q")
    return names


def fit_shapes(bench: Bench, numerics: Numerics = Numerics()) -> ShapeFit:
    """Returns the fit of the identifiable EI_body, EI_tail and K_Q to all static shapes.

    Raises `InputError` if a pressure bends the measured robot and the model to opposite sides.
    """
    shapes = bench.shapes
    robot = jax.tree.map(lambda x: jnp.asarray(x, float), bench.robot)
    names = identifiable_parameters(shapes)
    order = ["EI_body", "EI_tail", "K_Q"]
    free = np.array([order.index(n) for n in names])
    begin = np.log([given_values(bench.robot)[n] for n in order])
    rows = (
        jnp.asarray(np.concatenate([np.full(len(x.tip), x.on_tail) for x in shapes])),
        jnp.asarray(np.concatenate([x.force for x in shapes])),
        jnp.asarray(np.concatenate([x.pressure for x in shapes])),
    )
    ends = np.cumsum([len(x.tip) for x in shapes])[:-1]
    zeros = [np.r_[np.zeros(len(free)), np.arange(len(shapes)) == i] for i in range(len(shapes))]

    def tables(x):
        """Returns each table's prediction and tangents at x = (log fitted parameters, offsets)."""
        logs = begin.copy()
        logs[free] = x[: len(free)]
        value, slope = _shapes(jnp.asarray(logs), robot, rows, numerics)
        slope = np.concatenate(
            [np.asarray(slope)[..., free], np.zeros((*value.shape, len(shapes)))], axis=-1
        )
        found = []
        parts = zip(
            shapes, np.split(np.asarray(value), ends, 1), np.split(slope, ends, 1), strict=True
        )
        for i, (one, v, d) in enumerate(parts):
            used = 1 if one.joint is None else 2
            offset = x[len(free) + i]
            found.append((v[:used].ravel() + offset, d[:used].reshape(-1, d.shape[-1]) + zeros[i]))
        return found

    def linearised(noise):
        def function(x):
            found = tables(x)
            r = [(y - s.measured) / n for (y, _), s, n in zip(found, shapes, noise, strict=True)]
            J = [d / n for (_, d), n in zip(found, noise, strict=True)]
            return np.concatenate(r), np.concatenate(J)

        return function

    start = np.concatenate([begin[free], np.zeros(len(shapes))])
    _check_sides(shapes, tables(start))
    noise = [x.noise or FIRST_NOISE for x in shapes]
    least = levenberg_marquardt(linearised(noise), start)
    if any(x.noise is None for x in shapes):
        noise = _scatter(shapes, tables(least.x), noise, len(free))
        least = levenberg_marquardt(linearised(noise), least.x)
    return _shape_fit(names, shapes, least, tables(least.x), noise)


def _scatter(shapes, found, noise, shared: int) -> list[float]:
    """Returns every table's noise [m]: the declared noise or the residual's standard deviation."""
    result = []
    for s, (y, _), n in zip(shapes, found, noise, strict=True):
        if s.noise is None:
            residual = s.measured - y
            rows, total = len(residual), sum(len(x.measured) for x in shapes)
            freedom = max(rows - 1 - shared * rows / total, 1.0)
            n = max(float(np.sqrt(np.sum(residual**2) / freedom)), 1e-7)
        result.append(n)
    return result


def _shape_fit(names, shapes, least, found, noise) -> ShapeFit:
    k = len(names)
    declared = all(x.noise is not None for x in shapes)
    freedom = sum(len(x.measured) for x in shapes) - len(least.x)
    square = float(least.residual @ least.residual) / max(freedom, 1)
    inflation = max(1.0, square) if declared else 1.0
    times = 1.96 if declared else student_quantile(freedom)
    errors = np.sqrt(inflation * np.diag(least.inverse))
    values = np.exp(least.x[:k])
    return ShapeFit(
        parameters={
            n: BenchEstimate.of(float(v), float(v * e), times)
            for n, v, e in zip(names, values, errors[:k], strict=True)
        },
        correlations=(least.inverse / np.outer(*[np.sqrt(np.diag(least.inverse))] * 2))[:k, :k],
        predicted=[y for y, _ in found],
        noise=list(noise),
        offsets=[float(x) for x in least.x[k:]],
        mean_square=square if declared else float("nan"),
        converged=least.converged,
    )


def _check_sides(shapes, found) -> None:
    for s, (y, _) in zip(shapes, found, strict=True):
        here = y[: len(s.tip)]
        if s.kind == "pressure" and float((s.tip - s.tip.mean()) @ (here - here.mean())) < 0.0:
            raise InputError(
                f"{s.name}: the model bends to the other side than the robot; tip_m must "
                "be positive to the left, as seen from the tail: change the sign of tip_m or of "
                "the pressures"
            )
