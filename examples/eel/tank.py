"""Simulates measured trials of the eel, for the commands that read measurements.

    python examples/eel/tank.py FOLDER

The script writes `experiment.toml` and the trials' CSV files to FOLDER. The simulated eel differs
from the experiment file: it has other values of C_d, m_a, k and K_Q, and longer hoses to the
chambers in the rear (the effect `lag_mismatch`). The readings contain noise.
"""

import shutil
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

FILE = Path(__file__).parent / "experiment.toml"
TRUTH: dict[str, Any] = {
    "parameters.C_d": 3.0,
    "parameters.m_a": 0.8,
    "parameters.k": 0.08,
    "parameters.K_Q": 4.6e-7,
    "effects": [{"name": "lag_mismatch", "x": 0.3}],
}
"""Values of the simulated eel that the experiment file does not contain. The first chamber has the
time constant k, the middle chamber 1.15 k, and the last chamber 1.3 k."""
MESH = {"numerics.nodes": 81, "numerics.step": 1e-3}


def measure(experiment, folder: Path, truth: Mapping[str, Any] = TRUTH | MESH) -> None:
    """Simulates the trials with the values `truth`, and writes noisy readings to a folder."""
    from calibration.measurements.synthetic import Sensors, write_trials

    declared = experiment.sensors.model_dump()
    sensors = Sensors(**{key: declared[key] for key in Sensors().declared()})
    write_trials(folder, experiment.with_values(dict(truth), "tank.py"), 0, sensors)


def main(folder: Path) -> None:
    """Writes the experiment file and the measured trials to a folder."""
    import slider_jax
    from slider_jax.experiment.load import load

    slider_jax.enable_float64()
    folder.mkdir(parents=True, exist_ok=True)
    measure(load(FILE), folder)
    shutil.copy(FILE, folder)
    print(f"experiment.toml and the measured trials are in {folder}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "eel_tank"))
