"""Fits the free parameters to two runs, and predicts the speeds and the recoil of all runs."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex
from scipy.optimize import least_squares

from calibration.robot_fish.fish import (
    Dimensions,
    Parameters,
    hinge_drive,
    model_of_fish,
    robot_of_fish,
    tendon_drive,
)
from calibration.robot_fish.hinges import hinge_angles
from calibration.robot_fish.markers import (
    RELIABLE,
    LateralMotion,
    MarkerRun,
    behind_head,
    first_harmonic,
    lateral_motion,
    steady_speed_of,
)
from calibration.robot_fish.swim import SwimSettings, swim_jit
from slider_jax.errors import InputError, SolverError

CALIBRATED_ON = ("f1_00", "f1_75")
"""The two runs of the data's folder that determine the free parameters."""
WATER = ("C", "yaw_inertia", "sway_mass", "sway_exponent")
"""Parameters that are fitted to speed and recoil with the measured tail."""
DRIVE = ("pull",)
"""Parameter that is fitted to the speed, with the tendons."""
START = Parameters(C=3.0, yaw_inertia=0.03, sway_mass=1.2, sway_exponent=1.5, pull=0.9, hinge=0.35)
"""Initial values of the fitted parameters, and the value of `hinge`, which was chosen by hand.

With 0.24 N m/rad, tendons fit the speed of the two runs best, but above 1.3 Hz the speed is then
far below the straight line through both runs. 0.35 is a compromise.
"""
SPEED_ERROR, AMPLITUDE_ERROR, PHASE_ERROR = 0.02, 0.1, 1.0
"""Relative errors of speed and amplitudes and error [rad] of phases; weights of the fit."""


@dataclass(frozen=True)
class Swum:
    """Speed and recoil of a measured or simulated run."""

    speed: float
    """Steady speed [m/s]."""
    motion: LateralMotion
    stroke: complex
    """First harmonic [m] of marker 8 relative to the line through markers 0 and 1."""


@dataclass(frozen=True)
class FishCalibration:
    """The fitted model."""

    parameters: Parameters
    runs: tuple[str, ...]
    """Names of the runs that determine the parameters."""
    line: tuple[float, float]
    """Slope [m] and intercept [m/s] of the straight line of the speed against the beat."""
    per_beat: float
    """Speed over beat [m], if both were proportional."""


@dataclass(frozen=True)
class RunPrediction:
    """Measured and predicted values of a run."""

    run: MarkerRun
    measured: Swum
    kinematic: Swum
    """Prediction from the measured motion of the tail relative to the head."""
    before: Swum
    """`kinematic` without the two empirical inertias of the head."""
    tendons: Swum
    """Prediction from the beat frequency."""
    line: float
    proportional: float
    """Speeds [m/s] of the two trivial predictors."""


def observed(t, markers, beat: float) -> Swum:
    """Returns speed and recoil of markers (frames, 9, 2) [m] at times `t` [s]."""
    stroke = first_harmonic(t, behind_head(markers)[:, [8]], beat)[0]
    return Swum(steady_speed_of(t, markers), lateral_motion(t, markers, beat), complex(stroke))


@dataclass(frozen=True)
class FishSimulator:
    """Simulates the fish with the measured tail or with tendons."""

    size: Dimensions
    settings: SwimSettings = SwimSettings()

    def with_hinges(self, angles: Complex[np.ndarray, " 5"], beat: float, x: Parameters) -> Swum:
        """Simulates prescribed hinge angles, with the first harmonics `angles` (5,) [rad]."""
        numerics = self.settings.numerics
        return self._swim(
            hinge_drive(angles[None], beat, robot_of_fish(self.size), numerics), beat, x
        )

    def with_tendons(self, beat: float, x: Parameters) -> Swum:
        """Simulates a motor that turns once per beat and pulls the tendons."""
        return self._swim(tendon_drive(jnp.asarray(beat), _arrays(x)), beat, x)

    def _swim(self, actuators: tuple, beat: float, x: Parameters) -> Swum:
        f = jnp.asarray(beat)
        model = model_of_fish(self.size, _arrays(x), f, actuators)
        swam = swim_jit(model, f, 0.12 * f, self.settings)
        if not bool(swam.ok):
            raise SolverError(
                f"robot fish at {beat:g} Hz: a time step did not converge; use more steps per beat"
            )
        return observed(np.asarray(swam.t), np.asarray(swam.markers), beat)


def _arrays(x: Parameters) -> Parameters:
    """Returns the parameters as arrays, so that JAX compiles the simulation only once."""
    return Parameters(**{name: jnp.asarray(float(v)) for name, v in vars(x).items()})


def _recoil_errors(found: Swum, measured: Swum) -> list[float]:
    ours, theirs = found.motion, measured.motion
    errors = [(found.speed / measured.speed - 1.0) / SPEED_ERROR]
    largest = abs(theirs.sway[2])
    pairs = [(ours.sway[k], theirs.sway[k], abs(theirs.sway[k]) / largest) for k in (0, 1, 2)]
    for x, y, share in [*pairs, (ours.yaw, theirs.yaw, 1.0)]:
        errors += [(abs(x / y) - 1.0) / AMPLITUDE_ERROR, share * np.angle(x / y) / PHASE_ERROR]
    return errors


def _squared(errors: np.ndarray) -> np.ndarray:
    """Returns the squares of the errors, with their signs.

    Least squares of these squares minimises fourth powers, which keeps the largest error small.
    """
    return errors * np.abs(errors)


def _fitted(x: Parameters, names: tuple[str, ...], errors, step: float) -> Parameters:
    """Returns `x` with values of the parameters `names` that minimise the errors.

    A parameter keeps its sign.
    """
    start = np.array([getattr(x, name) for name in names])

    def at(z):
        return replace(x, **dict(zip(names, (start * z).tolist(), strict=True)))

    found = least_squares(
        lambda z: errors(at(z)), np.ones(len(names)), bounds=(0.05, 20.0), diff_step=step,
        max_nfev=20, xtol=1e-3, ftol=1e-3,
    )  # fmt: skip
    return at(found.x)


def calibrate_fish(
    runs: list[MarkerRun],
    simulator: FishSimulator,
    progress: Callable[[str], None] = lambda text: None,
) -> FishCalibration:
    """Fits the free parameters to speed and recoil of two `runs`.

    Raises `InputError` for another number of runs, or for equal beats.
    """
    if len(runs) != 2 or runs[0].beat == runs[1].beat:
        raise InputError(
            f"calibration of the robot fish: given {', '.join(x.name for x in runs) or 'no run'}; "
            "allowed two runs of different beats"
        )
    angles = [hinge_angles(run) for run in runs]
    beats = [run.beat for run in runs]
    measured = [observed(run.t, run.markers, run.beat) for run in runs]
    pairs = list(zip(angles, beats, measured, strict=True))

    def water(x):
        found = [_recoil_errors(simulator.with_hinges(a, f, x), m) for a, f, m in pairs]
        progress(f"  {', '.join(f'{name} {getattr(x, name):.4g}' for name in WATER)}")
        return _squared(np.concatenate(found))

    progress("fitting drag and inertia to the two runs")
    x = _fitted(START, WATER, water, 0.01)

    def drive(x):
        progress(f"  {', '.join(f'{name} {getattr(x, name):.4g}' for name in DRIVE)}")
        found = [simulator.with_tendons(f, x).speed - m.speed for _, f, m in pairs]
        return np.array(found)

    progress("fitting the motor's pull to the speed of the two runs")
    x = _fitted(x, DRIVE, drive, 0.05)
    speeds = np.array([m.speed for m in measured])
    slope, intercept = np.polyfit(beats, speeds, 1)
    per_beat = float(speeds @ beats / np.dot(beats, beats))
    names = tuple(run.name for run in runs)
    return FishCalibration(x, names, (float(slope), float(intercept)), per_beat)


def predict_run(run: MarkerRun, fitted: FishCalibration, simulator: FishSimulator) -> RunPrediction:
    """Returns the predictions for a run. The kinematic drive uses the run's tail, not its speed."""
    x, f = fitted.parameters, run.beat
    angles = hinge_angles(run)
    solid = float(simulator.size.mass[0])
    bare = replace(x, yaw_inertia=0.0, sway_mass=solid, sway_exponent=0.0)
    return RunPrediction(
        run,
        observed(run.t, run.markers, f),
        simulator.with_hinges(angles, f, x),
        simulator.with_hinges(angles, f, bare),
        simulator.with_tendons(f, x),
        fitted.line[0] * f + fitted.line[1],
        fitted.per_beat * f,
    )


def prediction_record(x: RunPrediction) -> dict[str, float | dict[str, float]]:
    """Returns the entry of a run in `speeds.json`."""

    def amplitudes(prefix: str, y: Swum) -> dict[str, float]:
        record = {f"{prefix}_amplitude_{k}_m": float(abs(y.motion.sway[k])) for k in RELIABLE}
        return record | {f"{prefix}_yaw_rad": float(abs(y.motion.yaw))}

    return {
        "beat_Hz": x.run.beat,
        "measured_m_per_s": x.measured.speed,
        "predicted_m_per_s": x.kinematic.speed,
        "predicted_from_frequency_m_per_s": x.tendons.speed,
        "before_m_per_s": x.before.speed,
        "line_m_per_s": x.line,
        "proportional_m_per_s": x.proportional,
        **amplitudes("measured", x.measured),
        **amplitudes("predicted", x.kinematic),
        **amplitudes("predicted_from_frequency", x.tendons),
    }
