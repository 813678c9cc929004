"""Fits a model of a soft arm with two tendons to known runs, and tests it on the given runs.

    SLIDER_DATA=../shared/data python scripts/tentacle.py MARKERS.csv --out results/tentacle

MARKERS.csv has a row for each static run, with the columns of the file `tentacle/markers.csv` of
the measured data. The script fits Young's modulus and the density to the runs in that file, not to
MARKERS.csv, and then searches for the effects that the model lacks. The model that makes the
predictions has at most four fitted parameters. The script writes DIR/predictions.json (errors of
the predictions for MARKERS.csv), DIR/result.json and DIR/close_loop.json.
"""

import argparse
import os
import sys
from pathlib import Path

from calibration.tentacle.candidates import candidates_of
from calibration.tentacle.close_loop import ArmSearch, close_arm_loop, search_record
from calibration.tentacle.fit import BASE, ArmFit, ArmProblem, distances, prediction_record_of_arm
from calibration.tentacle.runs import ArmRuns, read_arm_runs
from slider_jax.errors import InputError, SolverError
from slider_jax.io.files import input_file, provenance, staged, write_json
from slider_jax.precision import enable_float64


def known_runs() -> Path:
    """Returns the file of the runs to fit. Raises `InputError` if it is absent."""
    home = Path(os.environ.get("SLIDER_DATA") or Path(__file__).parents[2] / "shared" / "data")
    path = home / "tentacle" / "markers.csv"
    if not path.is_file():
        raise InputError(
            f"{path}: no such file; set the environment variable SLIDER_DATA to the folder that "
            "contains tentacle/markers.csv"
        )
    return path


def progress(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def table(search: ArmSearch, most: int = 8) -> list[str]:
    """Returns the lines of the printed tables: candidates, verdict, error and noise floor."""
    lines = []
    for number, round_ in enumerate(search.rounds, start=1):
        lines += [
            f"round {number}: a candidate needs a gain above {round_.least_gain:.1f}",
            f"  {'candidate':38s}{'gain':>7s}{'all runs':>12s}{'held out':>12s}  confirmed",
        ]
        lines += [
            f"  {x.score.name:38s}{x.score.gain:7.1f}{x.seen_mm:9.2f} mm{x.held_out_mm:9.2f} mm"
            f"  {'yes' if x.agreed else 'no'}"
            for x in round_.scores[:most]
        ]
        equal = f"; equivalent: {', '.join(round_.equivalent)}" if round_.equivalent else ""
        lines.append(f"  added: {round_.chosen or 'none'}{equal}")
    lines.append(f"verdict: {search.verdict}")
    lines += [f"  {name}: {status}" for name, status in search.statuses.items()]
    lines += [
        f"mean distance in held-out runs: {search.held_out_mm['base']:.2f} mm with the base "
        f"parameters, {search.held_out_mm['predictions']:.2f} mm with the effects, "
        f"{search.held_out_mm['selection']:.2f} mm if the other runs also select the effects"
    ]
    before, after = search.floors_mm
    if before is not None and after is not None:
        lines.append(
            f"noise floor from {len(search.pairs)} repeated runs: {before:.2f} mm with the base "
            f"parameters, {after:.2f} mm with all added effects"
        )
    return lines


def session_effects_apply(fit: ArmFit, problem: ArmProblem, runs: ArmRuns) -> bool:
    """Returns whether an effect of a session, if the model has one, applies to all runs."""
    fitted = {problem.candidates[i - len(BASE)].session for i in fit.free if i >= len(BASE)}
    known = {x.session for x in problem.candidates} - {""}
    return fitted <= {""} or set(runs.sessions) <= known


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description="Fits a model of a soft arm to the runs of SLIDER_DATA/tentacle/markers.csv, "
        "and compares its predictions with the markers of the runs in MARKERS.csv."
    )
    add = parser.add_argument
    add("markers", type=Path, metavar="MARKERS.csv", help="tensions and markers of the runs")
    add("--out", type=Path, required=True, metavar="DIR", help="folder for the results")
    given = parser.parse_args(argv)
    enable_float64()
    try:
        fitted_file = known_runs()
        runs, known = read_arm_runs(given.markers), read_arm_runs(fitted_file)
        problem = ArmProblem(known, candidates_of(known.sessions))
        target = ArmProblem(runs, problem.candidates)
        with staged(given.out) as stage:
            target.markers(problem.stated)  # an invalid run causes its error before the search
            search = close_arm_loop(problem, progress)
            if not session_effects_apply(search.used, problem, runs):
                progress(
                    "warning: runs without a known session have the mean effect of the sessions"
                )
            models = {
                "stated values": (problem.stated, ()),
                "E and density fitted": (search.start.theta, search.start.free),
                "with the effects": (search.used.theta, search.used.free),
            }
            result = {}
            for title, (theta, free) in models.items():
                off = distances(target.markers(theta), runs)
                result[title] = {
                    "fitted": {problem.names[i]: float(theta[i]) for i in free},
                    "mean_distance_mm": float(off.mean()),
                    "mean_distance_of_each_marker_mm": off.mean(axis=0).tolist(),
                }  # fmt: skip
            record = prediction_record_of_arm(target.markers(search.used.theta), runs)
            write_json(stage / "predictions.json", record)
            write_json(stage / "close_loop.json", search_record(problem, search))
            sources = [input_file(given.markers), input_file(fitted_file)]
            write_json(stage / "result.json", {"models": result, "input": sources} | provenance())
    except (InputError, SolverError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"fitted to {fitted_file}, {len(known.sessions)} runs:")
    print("\n".join(table(search)))
    print(f"compared with {given.markers}, {len(runs.sessions)} runs:")
    for title, found in result.items():
        print(f"{title}: mean distance {found['mean_distance_mm']:.2f} mm")
    progress(f"predictions.json, result.json and close_loop.json are in {given.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
