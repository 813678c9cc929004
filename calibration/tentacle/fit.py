"""Fits the arm's parameters to measured markers, and predicts the markers of other runs.

A parameter vector theta contains Young's modulus [Pa], the density [kg/m^3], and the values of all
candidates.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from calibration.tentacle.arm import (
    INCREMENTS,
    LENGTH,
    POINTS,
    ArmParameters,
    ArmShape,
    arm_parts,
    arm_shape,
)
from calibration.tentacle.candidates import Candidate, effect_values, strains_act, with_effects
from calibration.tentacle.runs import ArmRuns
from slider_jax.errors import SolverError

BASE = ("E", "density")
"""Names of the first two parameters."""
BASE_UNITS = ("Pa", "kg/m^3")
BASE_SCALES = (1e5, 300.0)
"""Size of a change of these parameters; a tenth of the prior range for the others."""
STEP = 1e-3
"""Step of the finite differences, as a fraction of the size of a change."""
MOST_STEPS, MOST_HALVINGS = 12, 5
"""Most steps of a fit, and most halvings of a step that fails or does not lower the error."""
MOST_REPEATS, LARGEST_CHANGE = 20, 1e-6 / LENGTH
"""Most repetitions of a shape for the effects that depend on the strains, and the largest change of
a strain in the last one."""
LEAST_DECREASE = 1e-4
"""A fit ends if a step lowers the sum of squares by less than this fraction."""


@eqx.filter_jit
def shapes_of_arms(
    base: Float[Array, "2"],
    values: Float[Array, "runs parameters"],
    tensions: Float[Array, "runs 2"],
    strains: Float[Array, "runs points 4"],
    share: Float[Array, ""],
) -> ArmShape:
    """Returns the shapes of the runs under a share of tensions and weight.

    `strains` are those of similar shapes. Effects that depend on the strains use these strains, so
    repeat the call until the shapes do not change.
    """

    def one(values, tensions, strains):
        parts = with_effects(arm_parts(ArmParameters(*base), tensions, strains), values)
        rod = replace(parts.rod, weight=share * parts.rod.weight)
        tendons = tuple(replace(x, tension=share * x.tension) for x in parts.tendons)
        return arm_shape(replace(parts, rod=rod, tendons=tendons), 1, strains)

    return jax.vmap(one)(values, tensions, strains)


class ArmProblem:
    """Measured runs, candidates, and a simulation that predicts the markers.

    Each shape is the first guess for the next one. This changes the iterations, not the result:
    with effects that depend on the strains, a shape is computed again until its strains agree.
    """

    def __init__(
        self,
        runs: ArmRuns,
        candidates: Sequence[Candidate],
        shapes: Callable[..., ArmShape] = shapes_of_arms,
    ):
        self.runs = runs
        self.candidates = tuple(candidates)
        self.names = (*BASE, *(x.name for x in candidates))
        self.stated = np.array([*ArmParameters(), *(x.prior.null for x in candidates)], float)
        ranges = [x.prior.high - x.prior.low for x in candidates]
        self.scales = np.array([*BASE_SCALES, *(0.1 * x for x in ranges)])
        self._shapes = shapes
        self._tensions = jnp.asarray(runs.tensions)
        self._strains: Array | None = None

    def _found(self, base: Array, values: Array, strains: Array, share: float = 1.0) -> ArmShape:
        return self._shapes(base, values, self._tensions, strains, jnp.asarray(share))

    def _repeated(self, base: Array, values: Array, strains: Array, found: ArmShape) -> ArmShape:
        """Repeats shapes until they agree with the strains that their effects use.

        Aitken's method relaxes the strains of each run: strong effects overshoot otherwise.
        """
        relaxation, before = np.ones((len(strains), 1, 1)), np.zeros(strains.shape)
        for count in range(MOST_REPEATS):
            change = np.asarray(found.strains - strains)
            # A shape that was not found may have strains that are not numbers.
            if not np.max(np.abs(change)) > LARGEST_CHANGE:
                return found
            if count:
                more = change - before
                size = np.maximum(np.sum(more**2, axis=(1, 2), keepdims=True), 1e-30)
                ratio = -np.sum(before * more, axis=(1, 2), keepdims=True) / size
                relaxation = np.clip(relaxation * ratio, 0.1, 5.0)
            strains, before = strains + relaxation * change, change
            found = self._found(base, values, strains)
        raise SolverError(
            f"the shape of the arm still changes after {MOST_REPEATS} repetitions; the effects of "
            "its strains may be too large"
        )

    def markers(self, theta: np.ndarray, keep: bool = True) -> np.ndarray:
        """Returns the markers (runs, 4, 3) [m]. `keep`: later shapes start from these shapes.

        Raises `SolverError` if a shape is not found.
        """
        values = effect_values(theta[len(BASE) :], self.candidates, self.runs.sessions)
        base = jnp.asarray(theta[: len(BASE)])
        strains = self._strains
        if strains is None:
            strains = jnp.zeros((len(self.runs.names), POINTS, 4))
            for share in np.arange(1, INCREMENTS + 1) / INCREMENTS:
                strains = self._found(base, values, strains, share).strains
        found = self._found(base, values, strains)
        if strains_act(values):
            found = self._repeated(base, values, strains, found)
        for name, ok in zip(self.runs.names, np.asarray(found.ok), strict=True):
            if not ok:
                raise SolverError(
                    f"{name}: the shape of the arm was not found; the tensions may be too large"
                )
        if keep or self._strains is None:
            self._strains = found.strains
        return np.asarray(found.markers)

    def slopes(self, theta: np.ndarray, chosen: Sequence[int] | None = None) -> np.ndarray:
        """Returns derivatives (parameters, runs, 4, 3) of the markers, from finite differences.

        They include the change of the strains that effects use. Only the rows `chosen` are
        computed (default: all); the other rows are 0.
        """
        middle = self.markers(theta)
        found = np.zeros((len(theta), *middle.shape))
        known: dict[int, np.ndarray] = {}
        for i in range(len(theta)) if chosen is None else chosen:
            candidate = self.candidates[i - len(BASE)] if i >= len(BASE) else None
            acts = np.ones(len(self.runs.names), bool)
            if candidate and candidate.session:
                acts = np.array([x == candidate.session for x in self.runs.sessions])
            if candidate is None or candidate.column not in known:
                # One simulation serves a parameter in all its sessions.
                step, moved = STEP * self.scales[i], theta.copy()
                at = i if candidate is None else self._everywhere(candidate)
                moved[at] += step
                change = (self.markers(moved, keep=False) - middle) / step
                if candidate:
                    known[candidate.column] = change
            else:
                change = known[candidate.column]
            found[i, acts] = change[acts]
        return found

    def _everywhere(self, candidate: Candidate) -> int:
        columns = [x.column for x in self.candidates]
        return len(BASE) + columns.index(candidate.column)


class ArmFit(NamedTuple):
    """A fitted model of the arm."""

    theta: np.ndarray
    free: tuple[int, ...]
    """Indices of the fitted parameters."""
    markers: np.ndarray
    """Predicted markers (runs, 4, 3) [m]."""


def fit_arm(
    problem: ArmProblem,
    theta: np.ndarray,
    free: Sequence[int],
    slopes: np.ndarray | None = None,
    held_out: int | None = None,
) -> ArmFit:
    """Returns the parameters `free` with the least mean square distance of the markers.

    The steps use the derivatives `slopes` (default: new derivatives for each step), and the run
    `held_out` has no weight. Raises `SolverError` if no shape is found.
    """
    free = tuple(free)
    used = np.arange(len(problem.runs.names)) != (-1 if held_out is None else held_out)

    def square(markers):
        return float(np.sum((markers - problem.runs.markers)[used] ** 2))

    markers = problem.markers(theta)
    best = square(markers)
    for _ in range(MOST_STEPS if free else 0):
        J = (problem.slopes(theta, free) if slopes is None else slopes)[list(free)][:, used]
        scale = problem.scales[list(free)]
        r = (problem.runs.markers - markers)[used].ravel()
        step = np.zeros_like(theta)
        matrix = J.reshape(len(free), -1).T * scale
        step[list(free)] = scale * np.linalg.lstsq(matrix, r, rcond=None)[0]
        for halving in range(MOST_HALVINGS + 1):
            trial = theta + step / 2**halving
            try:
                found = problem.markers(trial, keep=False)
            except SolverError:
                continue
            if square(found) < best:
                break
        else:
            return ArmFit(theta, free, markers)
        done = best - square(found) < LEAST_DECREASE * best
        theta, markers, best = trial, problem.markers(trial), square(found)
        if done:
            break
    return ArmFit(theta, free, markers)


def distances(markers: np.ndarray, runs: ArmRuns) -> np.ndarray:
    """Returns the distances (runs, 4) [mm] of predicted from measured markers."""
    return 1e3 * np.linalg.norm(markers - runs.markers, axis=2)


def prediction_record_of_arm(markers: np.ndarray, runs: ArmRuns) -> dict[str, Any]:
    """Returns the content of predictions.json: mean and rms distance [mm] of each run."""
    return {
        name: {"mean_distance_mm": float(d.mean()), "rms_mm": float(np.sqrt(np.mean(d**2)))}
        for name, d in zip(runs.names, distances(markers, runs), strict=True)
    }
