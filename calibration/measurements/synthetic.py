"""Synthetic tank experiments with known parameters: simulated trials with sensor noise.

The simulation and the fit (`calibration.model.predict`) use different meshes and time steps. With
equal meshes and time steps, the discretisation errors of data and fit would cancel.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from slider_jax.channels import SLIDER_CHANNELS, TIME, ChannelSet
from slider_jax.experiment.load import Experiment, assemble
from slider_jax.io.files import write_csv, write_text
from slider_jax.io.toml import toml_text
from slider_jax.simulation.trial import simulate_trial

NUMERICS = {"nodes": 81, "step": 1e-3, "scheme": "sdirk2", "tolerance": 1e-9}
"""Mesh, time step [s] and solver of the simulated tank."""
ROBOT = {
    "body_length": 0.3, "tail_length": 0.07, "linear_density": 0.7, "EI_body": 0.038,
    "EI_tail": 0.0058, "damping_time": 0.002, "height": 0.03,
    "front_chamber": [0.02, 0.145], "rear_chamber": [0.155, 0.28],
}  # fmt: skip
START = {"C_d": 3.5, "m_a": 0.7, "k": 0.087, "K_Q": 4.79e-7}
"""Parameters in the experiment file. A fit starts from these parameters."""
CAMERA_EVERY = 5
"""Number of force samples per frame of the camera that measures the tip."""


class Sensors(NamedTuple):
    """Noise and sample rate of the sensors, in SI units; noise as standard deviation."""

    pressure_noise: float = 700.0
    force_noise: float = 0.02
    force_tare: float = 0.01
    force_slow_noise: float = 0.01
    force_slow_time: float = 0.1
    tip_noise: float = 5e-4
    sample_rate: float = 500.0
    gain_drift: float = 0.01
    """Relative standard deviation of a force sensor's gain (not in the experiment file)."""

    def declared(self) -> dict[str, float]:
        """Returns the values that the experiment file declares."""
        return {k: v for k, v in self._asdict().items() if k != "gain_drift"}


class Truth(NamedTuple):
    """The true parameters of a synthetic tank."""

    parameters: Mapping[str, float]
    effects: Mapping[str, Mapping[str, float]]
    """Parameters of each effect; the key is the name of the effect."""


def random_base_parameters(rng: np.random.Generator) -> dict[str, float]:
    """Returns random values of C_d, m_a, k [s] and K_Q [m^3]."""
    return {
        "C_d": float(rng.uniform(2.4, 4.2)), "m_a": float(rng.uniform(0.45, 0.95)),
        "k": float(rng.uniform(0.06, 0.11)), "K_Q": float(rng.uniform(4.2e-7, 5.2e-7)),
    }  # fmt: skip


def random_trials(seed: int, count: int = 8, seconds: float = 1.0) -> list[dict[str, Any]]:
    """Returns trials with square waves of 0.6 to 6 Hz and random amplitude, phase and tow speed.

    `seconds` scales the durations. With 1, a trial lasts 5 s at 0.6 Hz, and 2 s from 1.5 Hz on.
    """
    rng = np.random.default_rng(seed)
    found = []
    for i, f in enumerate(np.geomspace(0.6, 6.0, count)):
        found.append(
            {
                "file": f"trial_{i:02d}.csv",
                "frequency": round(float(f), 2),
                "amplitude": float(rng.choice([150e3, 250e3, 330e3])),
                "rear_ratio": 0.9,
                "phase": float(rng.choice([-0.1, 0.0, 0.15, 0.3])),
                "tow_speed": float(rng.choice([0.0, 0.22])),
                "duration": round(seconds * max(2.0, 3.0 / float(f)), 3),
            }
        )
    return found


def write_tank(
    folder: Path,
    truth: Truth,
    runs: Sequence[Mapping[str, Any]],
    seed: int,
    sensors: Sensors = Sensors(),
    numerics: Mapping[str, Any] = NUMERICS,
) -> Path:
    """Simulates the trials `runs`, adds noise, and writes the trial files and experiment.toml.

    The experiment file contains the parameters `START` and no effects. Returns its path.
    """
    folder.mkdir(parents=True, exist_ok=True)
    declared = {
        "name": folder.name, "robot": ROBOT, "parameters": START, "sensors": sensors.declared(),
    }  # fmt: skip
    true = declared | {
        "parameters": dict(truth.parameters),
        "effects": [{"name": name, **values} for name, values in truth.effects.items()],
        "numerics": dict(numerics),
        "trials": [dict(run) for run in runs],
    }
    write_trials(folder, assemble(true, folder.name, folder), seed, sensors)
    write_text(folder / "experiment.toml", toml_text(declared | {"trials": list(runs)}))
    return folder / "experiment.toml"


def write_trials(folder: Path, true: Experiment, seed: int, sensors: Sensors) -> None:
    """Simulates the trials of the experiment `true`, adds noise, and writes the trials' files."""
    rng, channels = np.random.default_rng(seed), true.channels
    # The converter of the first pressure sensor has steps of 1 Pa.
    formats = {TIME: ".4f"} | {channels[name].column: ".0f" for name in channels.pressures[:1]}
    for trial in true.trials:
        columns = simulate_trial(true, trial).columns
        write_csv(folder / trial.file, with_sensor_noise(columns, sensors, rng, channels), formats)


def with_sensor_noise(
    true: Mapping[str, np.ndarray],
    sensors: Sensors,
    rng: np.random.Generator,
    channels: ChannelSet = SLIDER_CHANNELS,
) -> dict[str, np.ndarray]:
    """Returns the columns `true` of one trial with added sensor noise.

    A channel with own white noise keeps this noise. Cameras have `CAMERA_EVERY` times fewer frames.
    """
    t = true[TIME]
    n = len(t)
    columns = {TIME: t}
    for x in channels.values():
        read, white = true[x.column], x.white or getattr(sensors, x.noise, 0.0)
        if x.kind == "force":
            read = (
                (1.0 + sensors.gain_drift * rng.normal()) * read
                + sensors.force_tare * rng.normal()
                + sensors.force_slow_noise * slow_noise(t, sensors.force_slow_time, rng)
            )
        read = read + white * rng.normal(size=n)
        if x.kind == "camera":
            read = np.where(np.arange(n) % CAMERA_EVERY == 0, read, np.nan)
        columns[x.column] = read
    return columns


def slow_noise(t: np.ndarray, time: float, rng: np.random.Generator) -> np.ndarray:
    """Returns Ornstein-Uhlenbeck noise (n,) with unit variance and correlation time `time` [s]."""
    keep = np.exp(-np.diff(t, prepend=t[0]) / time)
    fresh = rng.normal(size=len(t))
    values = np.empty(len(t))
    values[0] = fresh[0]
    for i in range(1, len(t)):
        values[i] = keep[i] * values[i - 1] + np.sqrt(1.0 - keep[i] ** 2) * fresh[i]
    return values
