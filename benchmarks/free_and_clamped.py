"""Measures how well clamped and free trials together identify form drag and skin friction.

    python benchmarks/free_and_clamped.py --tanks 20 --out DIR

Each synthetic tank has its own parameters and sensor noise. Three trials are clamped, with
pressures, forces and tip position. Three trials are free, with pressures, forward speed and the
angle of the head. The fit identifies C_d, m_a, k, K_Q, the form drag of the head and the friction.
The benchmark counts the intervals of 95 % that contain the true value, and predicts the speed of a
further free trial. It writes one file per tank to DIR. An interrupted run resumes when you repeat
the command.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from calibration.identification.identify import identification_record, identify_parameters
from slider_jax.beam.parameters import SLIDER
from slider_jax.cli.main import prepare_jax
from slider_jax.experiment.load import Experiment, assemble
from slider_jax.io.files import write_csv, write_json
from slider_jax.simulation.trial import simulate_trial

RANGES = {
    "C_d": (1.5, 3.0), "m_a": (0.7, 1.1), "k": (0.05, 0.1), "K_Q": (4e-7, 6e-7),
    "head_drag.area": (1e-4, 6e-4), "tangential_friction.C_t": (0.01, 0.04),
}  # fmt: skip
"""Ranges from which the true values are drawn."""
NOISE = {"pressure": 300.0, "thrust": 2e-3, "recoil": 2e-3, "tip": 2e-4, "speed": 5e-3, "yaw": 5e-3}
"""Standard deviation of the white noise, in SI units."""
EFFECTS = ("head_drag", "tangential_friction")


def _trial(i: int, **keys: Any) -> dict[str, Any]:
    both = {"file": f"trial_{i}.csv", "rear_ratio": 0.9, "duration": 6.0}
    return both | keys


TRIALS = [
    _trial(0, frequency=1.5, amplitude=220e3, phase=0.1, tow_speed=0.1),
    _trial(1, frequency=2.4, amplitude=250e3, phase=0.15, tow_speed=0.3),
    _trial(2, frequency=3.3, amplitude=240e3, phase=0.05, tow_speed=0.0),
    _trial(3, frequency=1.8, amplitude=240e3, phase=0.15, support="free", start_speed=0.05),
    _trial(4, frequency=2.7, amplitude=250e3, phase=0.1, support="free", start_speed=0.1),
    _trial(5, frequency=3.6, amplitude=250e3, phase=0.15, support="free", start_speed=0.3),
]
NEW = _trial(9, frequency=3.0, amplitude=230e3, phase=0.12, support="free", start_speed=0.1)
"""A free trial that the fit does not see. Its speed is predicted."""


def experiment_with(values: dict[str, float], folder: Path, trials: list[dict]) -> Experiment:
    """Returns the experiment with the parameters `values`, by label."""
    robot = {key: x for key, x in SLIDER.items() if key != "K_Q"}
    effects = [
        {"name": name, key: values[f"{name}.{key}"]}
        for name, key in (x.split(".") for x in values if "." in x)
    ]
    content = {
        "name": "tank",
        "robot": robot,
        "parameters": {key: values[key] for key in ("C_d", "m_a", "k", "K_Q")},
        "sensors": {
            "pressure_noise": NOISE["pressure"],
            "force_noise": NOISE["thrust"],
            "tip_noise": NOISE["tip"],
            "sample_rate": 100.0,
            "channels": [
                {"kind": "speed", "columns": ["speed_m_per_s"], "noise": NOISE["speed"]},
                {
                    "kind": "angle", "name": "yaw", "s": 0.0, "columns": ["yaw_rad"],
                    "noise": NOISE["yaw"],
                },
            ],
        },
        "effects": effects,
        "trials": trials,
    }  # fmt: skip
    return assemble(content, "tank", folder)


def run_tank(seed: int, folder: Path) -> dict[str, Any]:
    """Returns truth, fit and predicted speed of one tank. `folder` receives its measured files."""
    rng = np.random.default_rng(seed)
    truth = {name: float(rng.uniform(*limits)) for name, limits in RANGES.items()}
    tank = experiment_with(truth, folder, TRIALS)
    folder.mkdir(parents=True, exist_ok=True)
    for i, trial in enumerate(tank.trials):
        true = simulate_trial(tank, i).columns
        measured = {"t_s": true["t_s"]}
        for name, channel in tank.channels.items():
            seen = trial.support == "free" if name in ("speed", "yaw") else trial.support != "free"
            if seen or channel.kind == "pressure":
                size = NOISE.get(name, NOISE["pressure"])
                noise = rng.normal(0.0, size, len(true["t_s"]))
                measured[channel.column] = true[channel.column] + noise
        write_csv(folder / trial.file, measured, {"t_s": ".6g"})
    guess = {"C_d": 2.2, "m_a": 0.9, "k": 0.08, "K_Q": 5e-7}
    found = identify_parameters(experiment_with(guess, folder, TRIALS), EFFECTS)
    record = identification_record(found, {})
    labels = [p.label for p in found.entries]
    fitted = dict(zip(labels, map(float, found.fit.theta), strict=True))
    speeds = []
    for values in (truth, fitted):
        run = simulate_trial(experiment_with(values, folder, [NEW]))
        last = run.t > run.t[-1] - 2.0 / NEW["frequency"]
        speeds.append(float(run.series["speed"][last].mean()))
    return {
        "seed": seed, "truth": truth, "parameters": record["parameters"],
        "speed_m_per_s": {"true": speeds[0], "predicted": speeds[1]},
        "trials": record["trials"], "doubt": record["doubt"],
    }  # fmt: skip


def summary(tanks: list[dict[str, Any]]) -> list[str]:
    """Returns one line for each parameter, and a line for the predicted speeds."""
    lines = []
    for name in RANGES:
        rows = [(x["truth"][name], x["parameters"][name]) for x in tanks]
        known = [(true, x) for true, x in rows if x["value"] is not None]
        inside = sum(x["low"] <= true <= x["high"] for true, x in known)
        off = [x["value"] / true - 1.0 for true, x in known]
        lines.append(
            f"{name:<26} {inside} of {len(known)} intervals hold the truth, {len(rows)} tanks; "
            f"relative error {np.mean(off):+.3f} +- {np.std(off):.3f}"
        )
    errors = [
        abs(x["speed_m_per_s"]["predicted"] / x["speed_m_per_s"]["true"] - 1.0) for x in tanks
    ]
    return [
        *lines,
        f"speed of a new free trial: error {np.mean(errors):.2%}, at most {max(errors):.2%}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tanks", type=int, default=20)
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    prepare_jax()
    found = []
    for seed in range(arguments.tanks):
        path = arguments.out / f"{seed}.json"
        if not path.exists():
            write_json(path, run_tank(seed, arguments.out / f"tank_{seed}"))
            print(f"tank {seed} of {arguments.tanks}", file=sys.stderr)
        found.append(json.loads(path.read_text()))
    print("\n".join(summary(found)))


if __name__ == "__main__":
    main()
