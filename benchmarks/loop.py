"""Measures how well the loop and other methods identify known missing effects in synthetic tanks.

    python benchmarks/loop.py null coverage single double outside --out DIR
    python benchmarks/loop.py table --out DIR

The benchmark writes one file per case to DIR. An interrupted run resumes when you repeat the
command. `table` prints a summary of all files. The other methods need scikit-learn.
"""

import argparse
import hashlib
import json
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import null
import numpy as np
import other_methods
from summary import summary_tables
from tanks import (
    close_tank_loop,
    detection_limits,
    noisy_records,
    problem_of,
    sample_tank,
    true_readings,
)
from unknown_effects import UNKNOWN_EFFECTS

from calibration.discrepancy.close_loop import LoopOutcome, choose_held_out
from calibration.inference.goodness import noise_floors, rms_errors
from calibration.inference.problem import AbstractProblem
from calibration.model.extended import candidate_effects
from slider_jax.effects.library import LIBRARY
from slider_jax.io.files import versions, write_json
from slider_jax.precision import enable_float64

SIZE_PARAMETERS = {
    "valve_delay": "delay", "fill_vent_asymmetry": "ratio", "leakage": "leak",
    "choked_flow": "inverse", "line_lag": "tau", "actuator_hysteresis": "amplitude",
    "body_stiffness": "x", "cubic_elasticity": "b", "clamp_compliance": "compliance",
    "tangential_friction": "C_t", "tip_mass": "mass", "tank_current": "U_x",
    "force_crosstalk": "angle", "camera_delay": "delay",
    "chamber_mismatch": "difference", "pressure_sensor_lag": "tau",
}  # fmt: skip
"""Effects, and for each effect the parameter that sets the effect's size."""
SIZES = (1, 3, 10)
"""Sizes of the effects, as multiples of the detection limit."""
PAIRS = (
    ("valve_delay", "tangential_friction"), ("fill_vent_asymmetry", "camera_delay"),
    ("leakage", "clamp_compliance"), ("line_lag", "tank_current"),
    ("actuator_hysteresis", "tank_current"), ("line_lag", "camera_delay"),
    ("clamp_compliance", "choked_flow"), ("tank_current", "body_stiffness"),
    ("valve_delay", "body_stiffness"), ("camera_delay", "body_stiffness"),
    ("clamp_compliance", "tank_current"), ("actuator_hysteresis", "camera_delay"),
)  # fmt: skip
PAIR_SIZE = 5.0
KINDS = ("null", "coverage", "single", "double", "outside", "table")
COMPARED_SIZES = (3, PAIR_SIZE)
"""Sizes of the effects for which the other methods also run."""
TANKS = 3
"""Number of tanks in which the effects are simulated."""


class Case(NamedTuple):
    """A tank with missing effects."""

    kind: str
    name: str
    seed: int
    """Seed of the tank."""
    effects: Mapping[str, Mapping[str, float]]
    size: float = 0.0
    stranger: str = ""
    """Name of an effect outside the library, or empty."""


def sizes_of(seed: int, out: Path) -> dict[tuple[str, str], float]:
    """Returns the detection limits in a tank from a file. Computes and writes a missing file."""
    path = out / f"limits_{seed}.json"
    if not path.exists():
        print(f"detection limits of tank {seed}", flush=True)
        write_json(path, {f"{e}.{p}": x for (e, p), x in detection_limits(seed).items()})
    found = json.loads(path.read_text())
    return {tuple(k.split(".")): np.inf if x is None else x for k, x in found.items()}


def _sized(effect: str, parameter: str, times: float, seed: int, out: Path) -> dict[str, float]:
    """Returns an effect's parameter at `times` the detection limit, with a random sign.

    The result is empty if the prior range does not include the value.
    """
    prior = LIBRARY[effect].priors()[parameter]
    distance = times * sizes_of(seed, out)[effect, parameter]
    rng = np.random.default_rng([seed, sorted(LIBRARY).index(effect)])
    signs = [-1.0, 1.0] if rng.random() < 0.5 else [1.0, -1.0]
    for sign in signs:
        if prior.low <= prior.null + sign * distance <= prior.high:
            return {parameter: prior.null + sign * distance}
    return {}


def cases(kind: str, out: Path) -> Iterator[Case]:
    """Yields the cases of a kind. Effects with a size outside the prior range are omitted."""
    if kind == "single":
        for times in reversed(SIZES):
            for i, (effect, parameter) in enumerate(SIZE_PARAMETERS.items()):
                sized = _sized(effect, parameter, times, i % TANKS, out)
                if sized:
                    yield Case(kind, f"{effect}_{times}", i % TANKS, {effect: sized}, times)
    if kind == "double":
        for i, pair in enumerate(PAIRS):
            both = {e: _sized(e, SIZE_PARAMETERS[e], PAIR_SIZE, i % TANKS, out) for e in pair}
            if all(both.values()):
                yield Case(kind, "+".join(pair), i % TANKS, both, PAIR_SIZE)
    if kind == "outside":
        for i, name in enumerate(UNKNOWN_EFFECTS):
            yield Case(kind, name, i % TANKS, {}, stranger=name)


def error_over_floor(
    problem: AbstractProblem, predicted: list[np.ndarray], floor: dict[str, float]
) -> float:
    """Returns the rms, over all channels, of a channel's rms error divided by its noise floor."""
    error = rms_errors(problem, predicted)
    return float(np.sqrt(np.mean([(error[c] / floor[c]) ** 2 for c in error])))


def run_case(case: Case, compared: bool, progress) -> dict[str, Any]:
    """Returns the results of the loop on a case, and of the other methods if `compared`."""
    tank = sample_tank(case.seed)
    own = [UNKNOWN_EFFECTS[case.stranger].effect()] if case.stranger else []
    start = time.perf_counter()
    true = true_readings(tank, case.effects, own)
    if not all(np.isfinite(y).all() for y in true):
        return {"left_out": "the tank cannot be simulated with this effect"}
    found = noisy_records(tank, true, noise_seed(case))
    held = choose_held_out(found)
    made, memo = time.perf_counter() - start, null.MemoryCache()
    start = time.perf_counter()
    outcome = close_tank_loop(tank, found, memo, progress)
    seconds = time.perf_counter() - start
    record = null.outcome_record(outcome, tank.truth) | {"seconds": seconds, "seconds_made": made}
    names = tuple(candidate_effects())
    problem = problem_of(tank, names, memo)
    fitted = problem([r for i, r in enumerate(found) if i not in held])
    rest = problem([found[i] for i in held])
    floor = noise_floors(rest, [true[i] for i in held])
    record["held_out_over_floor"] = {
        "refit only": error_over_floor(rest, rest.predict(outcome.search.base.theta), floor),
        "loop": error_over_floor(rest, rest.predict(outcome.chosen.theta), floor),
    }
    record["named_by"] = {}
    if compared and case.size in COMPARED_SIZES:
        s = other_methods.method_input(fitted, rest, outcome.entries, outcome.search.base)
        methods = {
            "sparse": other_methods.sparse,
            "stepwise": other_methods.stepwise,
            "gp": other_methods.gp,
        }
        for name, method in methods.items():
            progress(f"other method: {name}")
            result = method(s)
            record["named_by"][name] = result.effects
            record["held_out_over_floor"][name] = error_over_floor(rest, result.predicted, floor)
        result = other_methods.oracle(s, list(case.effects))
        record["held_out_over_floor"]["oracle"] = error_over_floor(rest, result.predicted, floor)
    if case.effects:
        record["effects_cover"] = _cover(outcome, case.effects)
    return record


def noise_seed(case: Case) -> int:
    """Returns a seed that is specific to a case."""
    digest = hashlib.sha256(f"{case.seed} {case.kind} {case.name}".encode()).digest()
    return int.from_bytes(digest[:7])


def _cover(outcome: LoopOutcome, effects: Mapping[str, Mapping[str, float]]) -> dict[str, Any]:
    found = {}
    for i, p in enumerate(outcome.entries):
        if p.effect in effects and p.name in effects[p.effect] and i in outcome.final.free:
            found[p.label] = null.interval_record(outcome.interval(i), effects[p.effect][p.name])
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("what", nargs="+", choices=KINDS, help="kinds of cases to run, or table")
    add("--out", type=Path, required=True, help="folder for the results")
    add("--only", default="", help="run only cases whose name contains this text (default: all)")
    add("--alone", action="store_true", help="omit the other methods, which halves the time")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    enable_float64()

    def work(path: Path, make) -> None:
        if path.exists() or arguments.only not in path.name:
            return
        path.parent.mkdir(exist_ok=True)
        start = time.perf_counter()

        def progress(text: str) -> None:
            print(f"{path.stem} {time.perf_counter() - start:5.0f} s  {text}", flush=True)

        write_json(path, make(progress) | {"versions": versions()})

    for what in arguments.what:
        if what == "table":
            print(summary_tables(arguments.out))
        elif what == "null":
            for seed in range(null.SEED, null.SEED + null.TANKS):
                work(arguments.out / what / f"{seed}.json", lambda p, s=seed: null.replicates(s, p))
        elif what == "coverage":
            for seed in range(null.FIRST_COVERED, null.FIRST_COVERED + null.COVERED):
                work(arguments.out / what / f"{seed}.json", lambda p, s=seed: null.coverage(s, p))
        else:
            for case in cases(what, arguments.out):
                about = {"case": case._asdict()}
                path = arguments.out / what / f"{case.name}.json"
                work(path, lambda p, c=case, a=about: a | run_case(c, not arguments.alone, p))


if __name__ == "__main__":
    main()
