"""Tanks with a known answer for the benchmark of the loop.

A tank is simulated on another mesh and with another step than the fitter's, one in six by another
scheme, read by sensors with tare, slow noise and a gain that drifts from trial to trial, and handed
over as what an experiment's files would hold.
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
from calibration.model.extended import BASE, base_values, base_vector, candidates, parameters
from calibration.model.predict import COARSE, Resolution, on_all_cores, plan, predict
from slider_jax.channels import CHANNELS
from slider_jax.effects import Effect
from slider_jax.experiment.load import Experiment, assemble

COUNT, SECONDS = 6, 0.33
"""Trials of a tank, and the scale of their durations (0.66 s at 6 Hz to 1.65 s at 0.6 Hz)."""
FINE = Resolution(51, 120, 2.0e-3)
"""Of the fitter's residuals."""
MADE = [
    Resolution(65, 200, 4.0e-4),
    Resolution(61, 150, 1.5e-3),
    Resolution(71, 300, 1.0e-3),
    Resolution(41, 200, 5.0e-5, "backward_euler"),
    Resolution(151, 200, 1.0e-3),
    Resolution(35, 120, 2.0e-3),
]
"""Mesh, step and scheme of the tanks, in turn. Fitted without noise they move C_d by -1 to 0.8 %,
m_a by -1.6 to 1 % and K_Q by -0.6 to 0.4 %; an independent program moves m_a by 1.2 %. Backward
Euler damps like a material by its whole step, where this robot's has 2 ms: steps of 0.15 ms are
found out, as material damping."""


@dataclass(frozen=True)
class Tank:
    """An experiment, what is true of it, and how it is simulated."""

    experiment: Experiment
    truth: dict[str, float]
    """Of the base parameters."""
    resolution: Resolution


def draw(seed: int, folder: Path = Path(".")) -> Tank:
    """A tank: its base parameters and drives drawn, its discretisation in turn."""
    truth = random_base_parameters(np.random.default_rng([seed, 1]))
    content = {
        "name": f"tank_{seed}", "robot": ROBOT, "parameters": START,
        "sensors": Sensors().declared(),
        "trials": random_trials(seed, COUNT, SECONDS),
    }  # fmt: skip
    return Tank(assemble(content, f"tank_{seed}", folder), truth, MADE[seed % len(MADE)])


def true_model(tank: Tank) -> Experiment:
    """The experiment with the tank's true base parameters."""
    e = tank.experiment
    return e.model_copy(update={"parameters": e.parameters.model_copy(update=tank.truth)})


def simulated(
    tank: Tank,
    effects: Mapping[str, Mapping[str, float]],
    own: Sequence[Effect] = (),
    names: Sequence[str] | None = None,
) -> list[np.ndarray]:
    """Readings (5, samples) of every trial, without noise; `effects` as a truth, or `own` ones.

    With `own` the program is made for them alone, else it is the extended model's with the effects
    `names`, all by default.
    """
    names = () if own else tuple(candidates() if names is None else names)
    entries = parameters(names)
    theta = base_vector(entries, tank.truth)
    for i, p in enumerate(entries):
        if p.effect in effects:
            theta[i] = effects[p.effect].get(p.name, p.prior.null)
    told = true_model(tank)
    plans = [plan(told, t, names, tank.resolution) for t in told.trials]
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
    return on_all_cores(lambda p: predict(p, theta), plans)


def noisy(tank: Tank, true: Sequence[np.ndarray], seed: int) -> list[Record]:
    """What the sensors of the tank record of `true` readings."""
    rng, found = np.random.default_rng([seed, 2]), []
    for trial, y in zip(tank.experiment.trials, true, strict=True):
        t = np.arange(y.shape[1]) / tank.experiment.sensors.sample_rate
        named = {"t_s": t} | {CHANNELS[c].column: row for c, row in zip(CHANNELS, y, strict=True)}
        columns = with_sensor_noise(named, Sensors(), rng)
        found.append(Record(trial, t, np.stack([columns[CHANNELS[c].column] for c in CHANNELS])))
    return found


def problem_of(tank: Tank, names: Sequence[str], memo=None):
    """How `conclude` lays out records of the tank."""

    def made(chosen: Sequence[Record]) -> TankProblem:
        laid = TankProblem.of(tank.experiment, list(chosen), tuple(names), fine=FINE, coarse=COARSE)
        return replace(laid, memo=memo)

    return made


def closed(
    tank: Tank, found: Sequence[Record], memo=None, progress=lambda text: None
) -> LoopOutcome:
    """The loop closed on records of a tank, all effects of the library being candidates."""
    names, base = tuple(candidates()), base_values(tank.experiment)
    laid = problem_of(tank, names, memo)
    held = choose_held_out(found)
    return conclude(tank.experiment, names, found, held, laid, base, tuple(BASE), progress)


def limits(seed: int) -> dict[tuple[str, str], float]:
    """Detection limit of every parameter in a tank at its true base parameters, SI."""
    found = detectability_matrix(true_model(draw(seed)))
    return {(x.parameter.effect, x.parameter.name): x.size for x in found.limits}
