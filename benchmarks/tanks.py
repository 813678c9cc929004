"""Synthetic tanks with known effects for the benchmark of the loop.

The mesh and time step of a tank differ from the fit's mesh and time step. One in six tanks also has
a different time scheme. The sensors have a tare, slow noise, and a gain that drifts from trial to
trial. The data have the form of an experiment's files.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import equinox as eqx
import numpy as np

from calibration.discrepancy.close_loop import LoopOutcome, choose_held_out, conclude
from calibration.experiment_design.detectability import detectability_matrix
from calibration.inference.problem import TankProblem
from calibration.measurements.records import Record
from calibration.measurements.synthetic import (
    ROBOT,
    START,
    Sensors,
    random_base_parameters,
    random_trials,
    with_sensor_noise,
)
from calibration.model.extended import (
    BASE,
    base_values,
    base_vector,
    candidate_effects,
    model_parameters,
)
from calibration.model.predict import COARSE, Resolution, on_all_cores, plan_trial, predict_readings
from slider_jax.channels import CHANNELS
from slider_jax.effects import Effect
from slider_jax.experiment.load import Experiment, assemble

COUNT, SECONDS = 6, 0.33
"""Number of trials per tank, and factor of the durations (0.66 s at 6 Hz to 1.65 s at 0.6 Hz)."""
FITTER_RESOLUTION = Resolution(51, 120, 2.0e-3)
"""Resolution of the fit's residuals."""
TANK_RESOLUTIONS = [
    Resolution(65, 200, 4.0e-4),
    Resolution(61, 150, 1.5e-3),
    Resolution(71, 300, 1.0e-3),
    Resolution(41, 200, 5.0e-5, "backward_euler"),
    Resolution(151, 200, 1.0e-3),
    Resolution(35, 120, 2.0e-3),
]
"""Mesh, time step and time scheme of the tanks, in turn. In fits without noise, they change C_d by
-1 to 0.8 %, m_a by -1.6 to 1 % and K_Q by -0.6 to 0.4 %. For comparison, data of a separately
written simulation program change m_a by 1.2 %. Backward Euler adds damping like a material with a
damping time of one time step; the robot's damping time is 2 ms. With time steps of 0.15 ms, the
loop identifies this numerical damping as material damping."""


@dataclass(frozen=True)
class Tank:
    """An experiment, the true base parameters, and the resolution of the simulation."""

    experiment: Experiment
    truth: dict[str, float]
    """True values of the base parameters."""
    resolution: Resolution


def sample_tank(seed: int, folder: Path = Path(".")) -> Tank:
    """Returns a tank with sampled base parameters and drives. Resolutions are used in turn."""
    truth = random_base_parameters(np.random.default_rng([seed, 1]))
    content = {
        "name": f"tank_{seed}", "robot": ROBOT, "parameters": START,
        "sensors": Sensors().declared(),
        "trials": random_trials(seed, COUNT, SECONDS),
    }  # fmt: skip
    return Tank(
        assemble(content, f"tank_{seed}", folder),
        truth,
        TANK_RESOLUTIONS[seed % len(TANK_RESOLUTIONS)],
    )


def true_model(tank: Tank) -> Experiment:
    """Returns the experiment with the tank's true base parameters."""
    e = tank.experiment
    return e.model_copy(update={"parameters": e.parameters.model_copy(update=tank.truth)})


def true_readings(
    tank: Tank,
    effects: Mapping[str, Mapping[str, float]],
    own: Sequence[Effect] = (),
    names: Sequence[str] | None = None,
) -> list[np.ndarray]:
    """Returns the readings (5, samples) of every trial without noise.

    `effects` are the true values of library effects. `own` are effects outside the library, which
    are added to the base model. Without `own`, the extended model contains the effects `names`
    (default: all effects of the library).
    """
    names = () if own else tuple(candidate_effects() if names is None else names)
    entries = model_parameters(names)
    theta = base_vector(entries, tank.truth)
    for i, p in enumerate(entries):
        if p.effect in effects:
            theta[i] = effects[p.effect].get(p.name, p.prior.null)
    experiment = true_model(tank)
    plans = [plan_trial(experiment, t, names, tank.resolution) for t in experiment.trials]
    if own:
        plans = [
            replace(
                p,
                extended=eqx.tree_at(
                    lambda x: x.base.effects, p.extended, (*p.extended.base.effects, *own)
                ),
            )
            for p in plans
        ]
    return on_all_cores(lambda p: predict_readings(p, theta), plans)


def noisy_records(tank: Tank, true: Sequence[np.ndarray], seed: int) -> list[Record]:
    """Returns the records of the tank's sensors for `true` readings."""
    rng, records = np.random.default_rng([seed, 2]), []
    for trial, y in zip(tank.experiment.trials, true, strict=True):
        t = np.arange(y.shape[1]) / tank.experiment.sensors.sample_rate
        named = {"t_s": t} | {CHANNELS[c].column: row for c, row in zip(CHANNELS, y, strict=True)}
        columns = with_sensor_noise(named, Sensors(), rng)
        records.append(Record(trial, t, np.stack([columns[CHANNELS[c].column] for c in CHANNELS])))
    return records


def problem_of(tank: Tank, names: Sequence[str], memo=None):
    """Returns the function with which `conclude` makes a problem from records."""

    def problem(chosen: Sequence[Record]) -> TankProblem:
        return replace(
            TankProblem.of(
                tank.experiment, list(chosen), tuple(names), fine=FITTER_RESOLUTION, coarse=COARSE
            ),
            memo=memo,
        )

    return problem


def close_tank_loop(
    tank: Tank, found: Sequence[Record], memo=None, progress=lambda text: None
) -> LoopOutcome:
    """Returns the loop's outcome on records of a tank, with all library effects as candidates."""
    names, base = tuple(candidate_effects()), base_values(tank.experiment)
    problem = problem_of(tank, names, memo)
    held = choose_held_out(found)
    return conclude(tank.experiment, names, found, held, problem, base, tuple(BASE), progress)


def detection_limits(seed: int) -> dict[tuple[str, str], float]:
    """Returns every parameter's detection limit (SI) in a tank at its true base parameters."""
    found = detectability_matrix(true_model(sample_tank(seed)))
    return {(x.parameter.effect, x.parameter.name): x.size for x in found.detection_limits}
