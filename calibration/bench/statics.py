"""Stiffness and moment per pressure from static shapes, all tables of a bench at once.

The shapes are those of the beam that `slider simulate` uses. Every table has an offset of its own,
the zero of its ruler. EI is fixed by tip loads; pressures fix K_Q, with the uncertainty of the EI
that was identified beside it.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from calibration.bench.least_squares import minimise, quantile
from calibration.bench.tables import Bench, Shapes
from slider_jax.actuation import Ideal, SineWave
from slider_jax.beam.parameters import Numerics, Robot
from slider_jax.dynamics.model import Drive, Model
from slider_jax.dynamics.statics import Loads, at_rest_under
from slider_jax.errors import InputError
from slider_jax.supports import Clamped

UNITS = {"EI_body": "N m^2", "EI_tail": "N m^2", "K_Q": "m^3", "damping_time": "s"}
DETERMINED = 0.5
"""Half an interval's width over the value, up to which a parameter counts as determined."""
FIRST_NOISE = 1e-3
"""Of a table that declares none, in the first of two fits [m]."""


class BenchEstimate(NamedTuple):
    """A parameter with its 95 % interval, SI."""

    value: float
    low: float
    high: float

    @classmethod
    def of(cls, value: float, error: float, times: float) -> "BenchEstimate":
        """From a standard error and the quantile; what cannot be negative is cut at 0."""
        return cls(value, max(0.0, value - times * error), value + times * error)

    @property
    def determined(self) -> bool:
        return self.high - self.value < DETERMINED * self.value


class ShapeFit(NamedTuple):
    """What static shapes say."""

    parameters: dict[str, BenchEstimate]
    correlations: np.ndarray
    """Of the parameters, in their order."""
    predicted: list[np.ndarray]
    """Tip, and joint behind it where there is one, of every table [m]."""
    noise: list[float]
    """Standard deviation that was used for every table [m]."""
    offsets: list[float]
    """Zero of every table [m]."""
    mean_square: float
    """Of the residual over the noise, where noise was declared; else nan."""
    converged: bool


def passive(robot: Robot) -> Model:
    """A robot in air, clamped and not driven."""
    still = SineWave(1.0, 0.0)
    return Model(robot, (), Ideal(), Drive(still, still), Clamped())


def tail_alone(robot: Robot) -> Robot:
    """The tail as a robot of its own, on the same mesh."""
    return replace(
        robot,
        body_length=0.8 * robot.tail_length,
        tail_length=0.2 * robot.tail_length,
        EI_body=robot.EI_tail,
        EA_body=robot.EA_tail,
    )


def _measured(x: Shapes) -> np.ndarray:
    return x.tip if x.joint is None else np.concatenate([x.tip, x.joint])


@eqx.filter_jit
def _shapes(logs: Float[Array, "3"], robot: Robot, rows, numerics: Numerics):
    """(tip, joint) (2, rows) [m] and their derivatives (2, rows, 3) to the logarithms.

    `logs` of EI_body, EI_tail, K_Q; `rows`: on_tail (rows,), force (rows,), pressure (rows, 2).
    """

    def displacements(logs):
        EI_body, EI_tail, K_Q = jnp.exp(logs)
        whole = replace(robot, EI_body=EI_body, EI_tail=EI_tail, K_Q=K_Q)

        def one(on_tail, force, pressure):
            chosen = jax.tree.map(lambda a, b: jnp.where(on_tail, a, b), tail_alone(whole), whole)
            loads = Loads(jnp.stack([jnp.zeros_like(force), force]), pressure)
            found = at_rest_under(passive(chosen), loads, numerics)
            both = jnp.stack([found.shape[1, 0], found.shape[1, numerics.tail_cells]])
            return jnp.where(found.ok, both, jnp.nan)

        return jax.vmap(one, out_axes=1)(*rows)

    slopes = jax.vmap(lambda d: jax.jvp(displacements, (logs,), (d,)), out_axes=(None, -1))
    return slopes(jnp.eye(3))


def identified(shapes: Sequence[Shapes]) -> list[str]:
    """Parameters that tables of these kinds are made to identify.

    A load on the whole robot, seen at its tip only, gives one stiffness: EI_body. The tail's
    asks for the joint's displacement or for a table with the tail alone.
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
    """Fit EI_body, EI_tail, K_Q, as far as there are tables for them, to all static shapes.

    Raises `InputError` where pressures bend the robot to the other side than the model's do.
    """
    shapes = bench.shapes
    robot = jax.tree.map(lambda x: jnp.asarray(x, float), bench.robot)
    names = identified(shapes)
    order = ["EI_body", "EI_tail", "K_Q"]
    free = np.array([order.index(n) for n in names])
    begin = np.log([float(getattr(bench.robot, n)) for n in order])
    rows = (
        jnp.asarray(np.concatenate([np.full(len(x.tip), x.on_tail) for x in shapes])),
        jnp.asarray(np.concatenate([x.force for x in shapes])),
        jnp.asarray(np.concatenate([x.pressure for x in shapes])),
    )
    ends = np.cumsum([len(x.tip) for x in shapes])[:-1]
    zeros = [np.r_[np.zeros(len(free)), np.arange(len(shapes)) == i] for i in range(len(shapes))]

    def tables(x):
        """Prediction and tangents of every table at x = (free logarithms, offsets)."""
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
            r = [(y - _measured(s)) / n for (y, _), s, n in zip(found, shapes, noise, strict=True)]
            J = [d / n for (_, d), n in zip(found, noise, strict=True)]
            return np.concatenate(r), np.concatenate(J)

        return function

    start = np.concatenate([begin[free], np.zeros(len(shapes))])
    _check_sides(shapes, tables(start))
    noise = [x.noise or FIRST_NOISE for x in shapes]
    least = minimise(linearised(noise), start)
    if any(x.noise is None for x in shapes):
        noise = _scatter(shapes, tables(least.x), noise, len(free))
        least = minimise(linearised(noise), least.x)
    return _told(names, shapes, least, tables(least.x), noise)


def _scatter(shapes, found, noise, shared: int) -> list[float]:
    """Standard deviation of every table that declares none, from what its fit leaves."""
    result = []
    for s, (y, _), n in zip(shapes, found, noise, strict=True):
        if s.noise is None:
            apart = _measured(s) - y
            freedom = max(len(apart) - 1 - shared * len(apart) / sum(map(_count, shapes)), 1.0)
            n = max(float(np.sqrt(np.sum(apart**2) / freedom)), 1e-7)
        result.append(n)
    return result


def _count(x: Shapes) -> int:
    return len(_measured(x))


def _told(names, shapes, least, found, noise) -> ShapeFit:
    k = len(names)
    declared = all(x.noise is not None for x in shapes)
    freedom = sum(map(_count, shapes)) - len(least.x)
    square = float(least.residual @ least.residual) / max(freedom, 1)
    inflation = max(1.0, square) if declared else 1.0
    times = 1.96 if declared else quantile(freedom)
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
                f"{s.name}: the model bends to the other side under these pressures; tip_m counts "
                "positive to the left, looking from tail to head: turn its sign, or that of both "
                "pressures"
            )
