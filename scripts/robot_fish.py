"""Predicts the speed of a tendon-driven robot fish from its tail's motion, and from its beat.

    SLIDER_DATA=../shared/data python scripts/robot_fish.py RUNS_FOLDER --out results/fish

RUNS_FOLDER contains the markers NAME_lab.csv and the beats `beats.json`, {NAME: Hz}. The free
parameters are fitted to the runs f1_00 and f1_75 in the folder `fishsim` of the measured data. The
script writes DIR/speeds.json, DIR/result.json and DIR/report.html.
"""

import argparse
import os
import sys
from pathlib import Path

from calibration.robot_fish.fish import read_dimensions
from calibration.robot_fish.markers import SUFFIX, read_beats, read_marker_run, read_marker_runs
from calibration.robot_fish.predict import CALIBRATED_ON, FishSimulator, calibrate_fish, predict_run
from calibration.robot_fish.report import (
    fish_page,
    fish_speeds_record,
    fish_speeds_table,
    settings_record,
)
from slider_jax.errors import InputError, SolverError
from slider_jax.io.files import input_file, staged, write_json, write_text
from slider_jax.precision import enable_float64


def data_folder() -> Path:
    """Returns the folder `fishsim` of the measured data. Raises `InputError` if it is absent."""
    home = Path(os.environ.get("SLIDER_DATA") or Path(__file__).parents[2] / "shared" / "data")
    folder = home / "fishsim"
    if not folder.is_dir():
        raise InputError(
            f"{folder}: no such folder; set SLIDER_DATA to the folder that contains fishsim"
        )
    return folder


def progress(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("runs", type=Path, metavar="RUNS_FOLDER", help="folder with NAME_lab.csv and beats.json")
    add("--out", type=Path, required=True, metavar="DIR", help="folder for the results")
    given = parser.parse_args(argv)
    enable_float64()
    try:
        runs = read_marker_runs(given.runs)
        known = data_folder()
        beats = read_beats(known / "beats.json")
        missing = [name for name in CALIBRATED_ON if name not in beats]
        if missing:
            raise InputError(f"{known / 'beats.json'}: no beat of {missing[0]}; add its beat")
        files = [known / f"{name}{SUFFIX}" for name in CALIBRATED_ON]
        both = [read_marker_run(path, beats[path.name.removesuffix(SUFFIX)]) for path in files]
        with staged(given.out) as stage:
            simulator = FishSimulator(read_dimensions(known))
            fitted = calibrate_fish(both, simulator, progress)
            found = []
            for k, run in enumerate(runs, start=1):
                progress(f"predicting {run.name} ({k} of {len(runs)})")
                found.append(predict_run(run, fitted, simulator))
            inputs = [given.runs / f"{x.name}{SUFFIX}" for x in runs]
            sources = [
                input_file(path)
                for path in (
                    given.runs / "beats.json", *inputs, known / "beats.json", *files,
                    known / "parts.csv", known / "fin_tail.csv", known / "fin_top.csv",
                )
            ]  # fmt: skip
            record = settings_record(found, fitted, simulator.settings, sources)
            write_json(stage / "speeds.json", fish_speeds_record(found))
            write_json(stage / "result.json", record)
            write_text(stage / "report.html", fish_page(found, fitted, record))
    except (InputError, SolverError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(fish_speeds_table(found))
    progress(f"speeds.json, result.json and report.html are in {given.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
