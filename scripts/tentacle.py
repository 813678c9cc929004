"""Predicts the markers of a soft arm with two tendons from the tensions.

    SLIDER_DATA=../shared/data python scripts/tentacle.py MARKERS.csv --out results/tentacle

MARKERS.csv has a row for each static run, with the columns of the file `tentacle/markers.csv` of
the measured data. Three parameters are fitted to the runs in that file. The script writes
DIR/predictions.json and DIR/result.json.
"""

import argparse
import os
import sys
from pathlib import Path

from calibration.tentacle.fit import (
    MODELS,
    distances,
    fit_arm,
    predicted_markers,
    prediction_record_of_arm,
)
from calibration.tentacle.runs import read_arm_runs
from slider_jax.errors import InputError, SolverError
from slider_jax.io.files import input_file, provenance, staged, write_json
from slider_jax.precision import enable_float64


def known_runs() -> Path:
    """Returns the file of the runs to fit. Raises `InputError` if it is absent."""
    home = Path(os.environ.get("SLIDER_DATA") or Path(__file__).parents[2] / "shared" / "data")
    path = home / "tentacle" / "markers.csv"
    if not path.is_file():
        raise InputError(f"{path}: no such file; set SLIDER_DATA to the folder with tentacle")
    return path


def progress(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("markers", type=Path, metavar="MARKERS.csv", help="tensions and markers of the runs")
    add("--out", type=Path, required=True, metavar="DIR", help="folder for the results")
    given = parser.parse_args(argv)
    enable_float64()
    try:
        runs, known = read_arm_runs(given.markers), read_arm_runs(known_runs())
        with staged(given.out) as stage:
            result = {}
            for title, names in MODELS.items():
                fit = fit_arm(known, names, progress)
                markers = predicted_markers(fit, runs)
                off = distances(markers, runs)
                result[title] = {
                    "parameters": fit.parameters._asdict(), "fitted": fit.fitted,
                    "mean_distance_mm": float(off.mean()),
                    "mean_distance_of_each_marker_mm": off.mean(axis=0).tolist(),
                }  # fmt: skip
            write_json(stage / "predictions.json", prediction_record_of_arm(markers, runs))
            sources = [input_file(given.markers), input_file(known_runs())]
            write_json(stage / "result.json", {"models": result, "input": sources} | provenance())
    except (InputError, SolverError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    for title, found in result.items():
        print(f"{title}: mean distance {found['mean_distance_mm']:.2f} mm")
    progress(f"predictions.json and result.json are in {given.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
