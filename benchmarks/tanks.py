"""Synthetic tanks with known effects for the benchmark of the loop.

The mesh and time step of a tank differ from the fit's mesh and time step. One in six tanks also has
a different time scheme. The sensors have a tare, slow noise, and a gain that drifts from trial to
trial. The data have the form of an experiment's files.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from calibration.discrepancy.close_loop import LoopOutcome, close_loop_on_records
from calibration.experiment_design.detectability import detectability_matrix
from calibration.measurements.records import Record
from calibration.measurements.synthetic import (
    ROBOT,
    START,
    Sensors,
    random_base_parameters,
    random_trials,
    with_sensor_noise,
)
from calibration.model.extended import base_vector, model_parameters
from calibration.model.plan import Resolution, plan_trial
from calibration.model.predict import predict_each
from slider_jax.channels import SLIDER_CHANNELS
from slider_jax.experiment.load import Experiment, assemble

SECONDS = 0.33
"""Factor of the durations of `random_trials`: 0.66 s at 6 Hz to 1.65 s at 0.6 Hz."""
FITTER_RESOLUTION = Resolution(51, 120, 2.0e-3)
"""Resolution of the fit's residuals."""
TANK_RESOLUTIONS = [
    Resolution(65, 200, 4.0e-4),
    Resolution(61, 150, 1.5e-3),
    Resolution(71, 300, 1.0e-3),
    Resolution(61, 200, 5.0e-5, "backward_euler"),
    Resolution(151, 200, 1.0e-3),
    Resolution(81, 200, 1.0e-3),
]
"""Mesh, time step and time scheme of the tanks, in turn. Their errors are at most 1 % of the
thrust's rms, 0.5 % of the recoil's and 0.2 % of the tip's, like those of the finer data sets of a
separately written program. Tanks of 35 nodes had errors of 3 %, 1.6 % and 0.5 %; in two of three,
the loop named an effect of this size. Backward Euler adds damping like a material with a damping
time of one time step; the robot's damping time is 2 ms."""
WHITE = ("pressure_noise", "force_noise", "tip_noise")
"""Fields of `Sensors` with the standard deviations of the white noise."""
NOISES = ("declared", "larger", "smaller", "heavy_tails", "drift")
"""Kinds of noise: as declared, 25 % more or less than declared, with the t-distribution of three
degrees of freedom, and with a random walk of the forces."""
SITUATIONS = ("quantised", "clock_skew", "no_force", "camera_only", "other_robot")
"""Situations of a laboratory: coarse converters (`STEPS`), a clock of the force sensor that is slow
by `SKEW`, no force sensor, only a camera, and another robot (`OTHER_ROBOT`)."""
STEPS = {"pressure": 1000.0, "force": 0.01, "camera": 5e-4}
"""Quantisation steps [Pa, N, m] of the situation `quantised`, about one standard deviation of the
white noise for pressure and camera."""
SKEW = 2e-4
"""Relative error of the clock, which is four times the tolerance of usual quartz oscillators."""
OTHER_ROBOT = ROBOT | {
    "body_length": 0.4, "tail_length": 0.09, "linear_density": 1.1, "EI_body": 0.06,
    "EI_tail": 0.012, "damping_time": 0.003, "height": 0.045,
    "front_chamber": [0.03, 0.19], "rear_chamber": [0.21, 0.37],
}  # fmt: skip
"""A robot that is longer, heavier and stiffer than SLIDER."""
WALK = 0.02
"""Standard deviation [N] of the random walk of a force after one second: the white noise."""


@dataclass(frozen=True)
class Tank:
    """An experiment, the true base parameters, and the resolution of the simulation."""

    experiment: Experiment
    truth: dict[str, float]
    """True values of the base parameters."""
    resolution: Resolution


def sample_tank(
    seed: int, trials: int = 6, folder: Path = Path("."), robot: Mapping[str, object] = ROBOT
) -> Tank:
    """Returns a tank with sampled base parameters and drives. Resolutions are used in turn."""
    truth = random_base_parameters(np.random.default_rng([seed, 1]))
    content = {
        "name": f"tank_{seed}", "robot": robot, "parameters": START,
        "sensors": Sensors().declared(),
        "trials": random_trials(seed, trials, SECONDS),
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
    tank: Tank, effects: Mapping[str, Mapping[str, float]], names: Sequence[str] = ()
) -> list[np.ndarray]:
    """Returns the readings (5, samples) of every trial without noise.

    `effects` are the true values of the effects' parameters. The extended model contains the
    effects `names`: with the same names, tanks with different effects share compiled programs.
    """
    entries = model_parameters(names)
    theta = base_vector(entries, tank.truth)
    for i, p in enumerate(entries):
        if p.effect in effects:
            theta[i] = effects[p.effect].get(p.name, p.prior.null)
    experiment = true_model(tank)
    plans = [plan_trial(experiment, t, tuple(names), tank.resolution) for t in experiment.trials]
    return predict_each([(p, theta) for p in plans])


def noisy_records(
    tank: Tank, true: Sequence[np.ndarray], seed: int, noise: str = "declared"
) -> list[Record]:
    """Returns the records of the tank's sensors for `true` readings.

    `noise` is one of `NOISES` or of `SITUATIONS`.
    """
    rng, records, declared = np.random.default_rng([seed, 2]), [], Sensors()
    factor = {"larger": 1.25, "smaller": 0.75, "heavy_tails": 0.0}.get(noise, 1.0)
    sensors = declared._replace(**{name: factor * getattr(declared, name) for name in WHITE})
    for trial, y in zip(tank.experiment.trials, true, strict=True):
        t = np.arange(y.shape[1]) / declared.sample_rate
        named = {"t_s": t} | {
            x.column: row for x, row in zip(SLIDER_CHANNELS.values(), y, strict=True)
        }
        if noise == "clock_skew":
            named |= {
                x.column: np.interp(t * (1.0 + SKEW), t, named[x.column])
                for x in SLIDER_CHANNELS.values()
                if x.kind == "force"
            }
        columns = with_sensor_noise(named, sensors, rng)
        for channel in SLIDER_CHANNELS.values():
            size, x = getattr(declared, channel.noise), columns[channel.column]
            if noise == "heavy_tails":
                x += size / np.sqrt(3.0) * rng.standard_t(3.0, len(t))
            if noise == "drift" and channel.kind == "force":
                x += WALK / np.sqrt(declared.sample_rate) * np.cumsum(rng.normal(size=len(t)))
            if noise == "quantised":
                x[:] = STEPS[channel.kind] * np.round(x / STEPS[channel.kind])
            if (noise == "no_force" and channel.kind == "force") or (
                noise == "camera_only" and channel.kind != "camera"
            ):
                x[:] = np.nan
        values = np.stack([columns[x] for x in SLIDER_CHANNELS.columns[1:]])
        records.append(Record(trial, t, values, SLIDER_CHANNELS))
    return records


@dataclass
class MemoryCache:
    """A cache of simulations, because the other methods repeat the loop's simulations.

    Its arrays are copies: the loop changes the arrays that it receives.
    """

    results: dict[bytes, list[np.ndarray]] = field(default_factory=dict)

    def cached(self, name, arrays, make):
        found = self.load(name, arrays)
        if found is None:
            found = make()
            self.store(name, arrays, found)
        return found

    def load(self, name, arrays):
        found = self.results.get(self.key(name, arrays))
        return None if found is None else [x.copy() for x in found]

    def store(self, name, arrays, made):
        self.results[self.key(name, arrays)] = [x.copy() for x in made]

    @staticmethod
    def key(name, arrays):
        return name.encode() + b"".join(np.ascontiguousarray(a).tobytes() for a in arrays)


def close_tank_loop(
    tank: Tank, found: Sequence[Record], names: Sequence[str], memo=None, progress=lambda text: None
) -> LoopOutcome:
    """Returns the loop's outcome on records of a tank, with the effects `names` as candidates."""
    return close_loop_on_records(
        tank.experiment, found, names, progress, FITTER_RESOLUTION, memo=memo
    )


def detection_limits(tank: Tank, names: Sequence[str]) -> dict[tuple[str, str], float]:
    """Returns the detection limits (SI) of the effects `names` at the true base parameters."""
    found = detectability_matrix(true_model(tank), names)
    return {(x.parameter.effect, x.parameter.name): x.size for x in found.limits}
