"""Fits the arm's parameters to measured markers, and predicts the markers of other runs."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares

from calibration.tentacle.arm import ArmParameters, arms_under
from calibration.tentacle.runs import ArmRuns
from slider_jax.errors import SolverError

SCALES = {"E": 1e5, "density": 300.0, "base": 0.01}
"""Size of a change of each parameter, for the least-squares solver."""
MODELS = {
    "stated values": (),
    "E and density fitted": ("E", "density"),
    "E, density and place of the base fitted": ("E", "density", "base"),
}
"""Models from the simplest to the one that makes the predictions, and their fitted parameters."""


FAR = 1.0
"""Distance [m] that replaces all distances if a shape is not found; the solver then steps back."""


class ArmFit(NamedTuple):
    """A fitted model of the arm."""

    parameters: ArmParameters
    fitted: tuple[str, ...]


@eqx.filter_jit
def _slopes(vector, names: tuple[str, ...], tensions, start):
    """Returns the derivatives (parameters, runs, 4, 3) of the markers."""

    def markers(x):
        return arms_under(_with(names, x), tensions, start).markers

    one = jnp.eye(len(names))
    return jax.vmap(lambda d: jax.jvp(markers, (vector,), (d,))[1])(one)


def _with(names: tuple[str, ...], vector) -> ArmParameters:
    return ArmParameters(**{name: SCALES[name] * x for name, x in zip(names, vector, strict=True)})


def fit_arm(
    runs: ArmRuns, names: Sequence[str], progress: Callable[[str], None] = lambda text: None
) -> ArmFit:
    """Returns the parameters `names` with the least mean square distance of the markers.

    Raises `SolverError` if the arm's shape is not found.
    """
    names = tuple(names)
    stated = ArmParameters()
    if not names:
        return ArmFit(stated, names)
    tensions = jnp.asarray(runs.tensions)
    first = _checked(arms_under(stated, tensions), runs)
    # Each shape is the first guess for the next; it changes the iterations, not the result.
    latest = {"strains": first.strains}

    def residual(vector):
        found = arms_under(_with(names, vector), tensions, latest["strains"])
        if not bool(found.ok.all()):
            return np.full(runs.markers.size, FAR)
        latest["strains"] = found.strains
        distance = np.asarray(found.markers) - runs.markers
        progress(f"{', '.join(names)}: rms {1e3 * _rms(distance):.3f} mm")
        return distance.ravel()

    def slopes(vector):
        found = _slopes(jnp.asarray(vector), names, tensions, latest["strains"])
        return np.asarray(found).reshape(len(names), -1).T

    start = np.array([getattr(stated, name) / SCALES[name] for name in names])
    solution = least_squares(residual, start, slopes, xtol=1e-6, ftol=1e-8)
    return ArmFit(ArmParameters(*(float(x) for x in _with(names, solution.x))), names)


def predicted_markers(fit: ArmFit, runs: ArmRuns) -> np.ndarray:
    """Returns the markers (runs, 4, 3) [m]. Raises `SolverError` if a shape is not found."""
    tensions = jnp.asarray(runs.tensions)
    return np.asarray(_checked(arms_under(fit.parameters, tensions), runs).markers)


def _checked(found, runs: ArmRuns):
    for name, ok in zip(runs.names, np.asarray(found.ok), strict=True):
        if not ok:
            raise SolverError(
                f"{name}: the shape of the arm was not found; the tensions may be too large"
            )
    return found


def _rms(distance: np.ndarray) -> float:
    """Returns the root mean square of the lengths of vectors (..., 3)."""
    return float(np.sqrt(np.mean(np.sum(distance**2, axis=-1))))


def distances(markers: np.ndarray, runs: ArmRuns) -> np.ndarray:
    """Returns the distances (runs, 4) [mm] of predicted from measured markers."""
    return 1e3 * np.linalg.norm(markers - runs.markers, axis=2)


def prediction_record_of_arm(markers: np.ndarray, runs: ArmRuns) -> dict[str, Any]:
    """Returns the content of predictions.json: mean and rms distance [mm] of each run."""
    return {
        name: {"mean_distance_mm": float(d.mean()), "rms_mm": float(np.sqrt(np.mean(d**2)))}
        for name, d in zip(runs.names, distances(markers, runs), strict=True)
    }
