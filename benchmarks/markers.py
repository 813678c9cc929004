"""Finds a hidden effect from pressures and five markers, without a force sensor.

    python benchmarks/markers.py --out DIR

Each synthetic tank has other parameters and one effect that its experiment file does not declare.
Three clamped trials contain the pressures and the lateral positions of five markers, with noise of
1 mm. The benchmark runs `slider close-loop` on each tank and prints the effects found, and whether
the intervals of 95 % contain the true values. An interrupted run resumes when you repeat the
command.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from slider_jax.beam.parameters import SLIDER
from slider_jax.cli.main import main as slider, prepare_jax
from slider_jax.experiment.load import Experiment, assemble
from slider_jax.io.files import write_csv, write_text
from slider_jax.optimise.design_space import to_toml
from slider_jax.simulation.trial import simulate_trial

HIDDEN: tuple[tuple[str, dict[str, float]], ...] = (
    ("tail_stiffness", {"x": 0.4}),
    ("lag_mismatch", {"x": 0.3}),
    ("chamber_mismatch", {"difference": 0.1}),
)
RANGES = {"C_d": (1.5, 3.0), "m_a": (0.7, 1.1), "k": (0.05, 0.1), "K_Q": (4e-7, 6e-7)}
"""Ranges from which the true values are drawn."""
GUESS = {"C_d": 2.2, "m_a": 0.9, "k": 0.08, "K_Q": 5e-7}
PRESSURE_NOISE, MARKER_NOISE = 300.0, 1e-3
MARKERS = (0.07, 0.15, 0.23, 0.31, 0.36)
"""Distances of the markers from the head [m]."""
TRIALS = [
    {"frequency": 1.5, "amplitude": 220e3, "phase": 0.1, "tow_speed": 0.1},
    {"frequency": 2.4, "amplitude": 250e3, "phase": 0.15, "tow_speed": 0.3},
    {"frequency": 3.3, "amplitude": 240e3, "phase": 0.05, "tow_speed": 0.0},
]


def experiment_with(
    values: dict[str, float], effects: list[dict[str, Any]], folder: Path
) -> Experiment:
    """Returns the experiment with the parameters `values` and the `effects`."""
    channels = [
        {"kind": "marker", "name": f"m{i}", "s": s, "columns": [f"y{i}_m"], "noise": MARKER_NOISE}
        for i, s in enumerate(MARKERS)
    ]
    content = {
        "name": "markers",
        "robot": {key: x for key, x in SLIDER.items() if key != "K_Q"},
        "parameters": values,
        "sensors": {
            "pressure_noise": PRESSURE_NOISE, "sample_rate": 100.0, "channels": channels,
        },
        "effects": effects,
        "trials": [
            {"file": f"trial_{i}.csv", "rear_ratio": 0.9, "duration": 6.0} | trial
            for i, trial in enumerate(TRIALS)
        ],
    }  # fmt: skip
    return assemble(content, "tank", folder)


def make_tank(seed: int, folder: Path) -> dict[str, float]:
    """Writes the experiment file and the measured files of a tank, and returns the true values."""
    rng, (effect, values_of_effect) = np.random.default_rng(seed), HIDDEN[seed]
    values = {key: float(rng.uniform(*limits)) for key, limits in RANGES.items()}
    tank = experiment_with(values, [{"name": effect} | values_of_effect], folder)
    folder.mkdir(parents=True, exist_ok=True)
    for i, trial in enumerate(tank.trials):
        true = simulate_trial(tank, i).columns
        measured = {"t_s": true["t_s"]}
        sizes = {"p_front_Pa": PRESSURE_NOISE, "p_rear_Pa": PRESSURE_NOISE}
        sizes |= {f"y{j}_m": MARKER_NOISE for j in range(len(MARKERS))}
        for column, size in sizes.items():
            noise = rng.normal(0.0, size, len(true["t_s"]))
            measured[column] = true[column] + noise
        write_csv(folder / trial.file, measured, {"t_s": ".6g"})
    write_text(folder / "experiment.toml", to_toml(experiment_with(GUESS, [], folder)))
    return values | {f"{effect}.{key}": x for key, x in values_of_effect.items()}


def lines_of(report: dict[str, Any], truth: dict[str, float]) -> list[str]:
    """Returns the effects found, and one line for each true value with its interval of 95 %."""
    found = dict(report["parameters"])
    for effect in report["effects"]:
        found |= {f"{effect['name']}.{key}": x for key, x in effect["parameters"].items()}
    names = ", ".join(
        " or ".join([effect["name"], *effect["class"]]) for effect in report["effects"]
    )
    lines = [f"{report['verdict']}: {names}"]
    for key, true in truth.items():
        x = found.get(key)
        if x is None:
            lines.append(f"{key}: true {true:.5g}, not found")
            continue
        holds = "holds" if x["low"] <= true <= x["high"] else "does not hold"
        lines.append(
            f"{key}: {x['value']:.5g} ({x['low']:.5g} to {x['high']:.5g}) {holds} {true:.5g}"
        )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tanks", type=int, choices=range(1, len(HIDDEN) + 1), default=len(HIDDEN))
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    prepare_jax()
    for seed in range(arguments.tanks):
        folder = arguments.out / f"tank_{seed}"
        truth = make_tank(seed, folder)
        file = folder / "experiment.toml"
        if slider(["close-loop", str(file), "--out", str(folder / "loop")]) != 0:
            raise SystemExit(f"close-loop failed on {file}")
        report = json.loads((folder / "loop" / "report.json").read_text())
        print("\n".join(lines_of(report, truth)))


if __name__ == "__main__":
    main()
