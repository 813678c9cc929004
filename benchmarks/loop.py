"""Measures how well the loop and other methods identify known missing effects in synthetic tanks.

    python benchmarks/loop.py null noise situation single single8 double double8 --out DIR
    python benchmarks/loop.py outside fresh blind unseen novel further --out DIR
    python benchmarks/loop.py common everyday workshop field --out DIR
    python benchmarks/loop.py table --out DIR

The benchmark writes one file per tank to DIR. An interrupted run resumes when you repeat the
command, and several processes can share DIR (--part). `table` prints a summary of all files. The
other methods need scikit-learn.
"""

import argparse
import hashlib
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import other_methods
from summary import LACKING, summary_tables
from tanks import (
    NOISES,
    OTHER_ROBOT,
    SITUATIONS,
    MemoryCache,
    Tank,
    close_tank_loop,
    detection_limits,
    noisy_records,
    sample_tank,
    true_readings,
)

from calibration.discrepancy import report
from calibration.discrepancy.close_loop import LoopOutcome
from calibration.discrepancy.verdict import CLASS, IDENTIFIED, LEARNED, PARTLY
from calibration.inference.gauss_newton import fit_gauss_newton
from calibration.inference.goodness import noise_floors, rms_errors
from calibration.inference.problem import AbstractProblem, TankProblem
from calibration.learning.learn import Learning, learn_terms
from calibration.model.compiled import limit_memory_maps
from calibration.model.extended import candidate_effects
from slider_jax.cli.main import prepare_jax
from slider_jax.effects.library import LIBRARY, load_effects
from slider_jax.io.files import versions, write_json

SINGLES = {
    "valve_delay": "delay", "rear_valve_delay": "delay", "regulator_gain": "gain",
    "supply_depletion": "rate",
    "fill_vent_asymmetry": "ratio", "leakage": "leak", "choked_flow": "inverse",
    "valve_overlap": "band", "side_lag": "x", "lag_mismatch": "x",
    "line_lag": "tau", "actuator_hysteresis": "amplitude", "chamber_mismatch": "difference",
    "side_mismatch": "difference", "actuator_creep": "share",
    "body_stiffness": "x", "tail_stiffness": "x", "material_damping": "x",
    "cubic_elasticity": "b", "internal_friction": "z_c", "tail_relaxation": "E_1",
    "tail_rest_curvature": "kappa_0", "joint_compliance": "compliance",
    "clamp_compliance": "compliance", "sway_compliance": "compliance",
    "tangential_friction": "C_t", "tip_mass": "mass", "tail_drag": "C", "side_drag": "C",
    "head_drag": "area",
    "tank_current": "U_x", "tow_speed_error": "gain",
    "pressure_sensor_lag": "tau", "force_crosstalk": "angle", "force_clock_offset": "delay",
    "camera_delay": "delay", "lens_distortion": "k",
    "wake_memory": "m_w", "edge_vortices": "C", "leading_edge_separation": "K",
}  # fmt: skip
"""Effects, and for each effect the parameter that sets the effect's size."""
SIZES = (10, 3, 1)
"""Sizes of the effects, as multiples of the detection limit."""
PAIRS = (
    ("valve_delay", "tangential_friction"), ("fill_vent_asymmetry", "camera_delay"),
    ("leakage", "clamp_compliance"), ("line_lag", "tank_current"),
    ("force_crosstalk", "tail_stiffness"),
    ("actuator_hysteresis", "tank_current"), ("line_lag", "camera_delay"),
    ("clamp_compliance", "choked_flow"), ("tank_current", "body_stiffness"),
    ("camera_delay", "side_lag"),
    ("valve_delay", "body_stiffness"), ("camera_delay", "body_stiffness"),
    ("clamp_compliance", "tank_current"), ("actuator_hysteresis", "camera_delay"),
    ("valve_delay", "tip_mass"),
    ("side_mismatch", "force_clock_offset"), ("internal_friction", "tow_speed_error"),
    ("chamber_mismatch", "tail_drag"), ("tail_rest_curvature", "leakage"),
    ("tip_mass", "side_lag"),
    ("pressure_sensor_lag", "head_drag"), ("supply_depletion", "lens_distortion"),
    # Two effects of the same part of the rig.
    ("valve_delay", "fill_vent_asymmetry"), ("tail_stiffness", "material_damping"),
    ("tank_current", "tail_drag"),
)  # fmt: skip
"""Pairs of effects. The first effect of every fifth pair is beyond its prior range."""
PAIR_SIZE, BEYOND = 5.0, 1.4
"""Size of the effects in pairs, in detection limits, and size of an effect beyond its prior range,
as a multiple of the distance from the null to the range's farther end."""
NULL_TANKS, NOISE_TANKS = 108, 12
"""Number of tanks without a missing effect, and number of them for each kind of wrong noise."""
FIRST_NULL, FIRST_NOISE = 3000, 5000
"""Seed of the first of these tanks. Nine null tanks (3000 to 3003, 3005, 3039, 3041, 3075 and 3077)
were examined before the rule for the measured noise and the meshes of the tanks were changed. No
setting was chosen with the other seeds."""
TANKS = 3
"""Number of tanks in which the effects are simulated."""
TRIALS, TRIALS_OUTSIDE = 6, 8
"""Number of trials of a tank. The loop learns a function only from eight or more trials."""
COMPARED = 6
"""The other methods run on this number of tanks of each kind and size."""
IN_SITUATIONS = ("valve_delay", "body_stiffness", "clamp_compliance")
"""Effects that are tested in each situation of a laboratory, at ten times the detection limit."""
SITUATION_TANKS, FIRST_SITUATION = 6, 7000
"""Number of tanks without a missing effect in each situation, and seed of the first."""
LONGER = {"single8": "single", "double8": "double"}
"""Kinds with eight trials, in which functions may replace effects, and the same kinds with six."""
KINDS = ("null", "noise", "situation", "single", "double", *LONGER, *LACKING, "table")


class Case(NamedTuple):
    """A tank with or without missing effects."""

    kind: str
    name: str
    seed: int
    """Seed of the tank."""
    effects: Mapping[str, Mapping[str, float]] = {}
    size: float = 0.0
    noise: str = "declared"
    """One of `NOISES` or of `SITUATIONS`."""
    compared: bool = False
    """Whether the other methods run on this tank."""


def trials_of(kind: str) -> int:
    """Returns the number of trials of the tanks of a kind."""
    return TRIALS_OUTSIDE if kind in LACKING or kind in LONGER else TRIALS


def limits_of(kind: str, seed: int, out: Path) -> dict[str, float]:
    """Returns the detection limits in a tank from a file. Computes and writes a missing file."""
    path = out / f"limits_{kind if kind in LACKING else 'library'}_{seed}.json"
    if not path.exists():
        print(f"computing {path.name}", flush=True)
        names = [*LACKING.get(kind, SINGLES)]
        trials = trials_of(kind) if kind in LACKING else TRIALS
        found = detection_limits(sample_tank(seed, trials), names)
        write_json(path, {f"{e}.{p}": x for (e, p), x in found.items()})
    return {k: np.inf if x is None else x for k, x in json.loads(path.read_text()).items()}


def tank_of(case: Case) -> Tank:
    """Returns the tank of a case."""
    trials = trials_of(case.kind)
    if case.noise == "other_robot":
        return sample_tank(case.seed, trials, robot=OTHER_ROBOT)
    return sample_tank(case.seed, trials)


def _seeded(*parts: Any) -> int:
    """Returns a seed that is specific to `parts`."""
    return int.from_bytes(hashlib.sha256(" ".join(map(str, parts)).encode()).digest()[:7])


def _sized(effect: str, parameter: str, distance: float, seed: int) -> dict[str, float]:
    """Returns an effect's parameter at a distance from its null with a random sign, and its shapes.

    The shape parameters are sampled between a third and three times their default, inside their
    prior range. The result is empty if the prior range does not include the parameter's value.
    """
    prior, shapes = LIBRARY[effect].priors()[parameter], LIBRARY[effect].shapes()
    rng = np.random.default_rng(_seeded(seed, effect))
    signs = [-1.0, 1.0] if rng.random() < 0.5 else [1.0, -1.0]
    found = {
        name: float(np.clip(p.null * 3.0 ** rng.uniform(-1.0, 1.0), p.low, p.high))
        for name, p in shapes.items()
    }
    for sign in signs:
        if prior.low <= prior.null + sign * distance <= prior.high:
            return found | {parameter: prior.null + sign * distance}
    return {}


def _beyond(effect: str, parameter: str, seed: int) -> dict[str, float]:
    """Returns an effect's parameter beyond its prior range, inside the physical limits."""
    prior = LIBRARY[effect].priors()[parameter]
    end = max(prior.low, prior.high, key=lambda x: abs(x - prior.null))
    shapes = _sized(effect, parameter, 0.0, seed)
    return shapes | {parameter: prior.null + BEYOND * (end - prior.null)}


def _complete_models(kind: str, noises: Sequence[str], first: int, count: int) -> Iterator[Case]:
    """Yields `count` cases without a missing effect for each of `noises`; `first` is a seed."""
    for k in range(count):
        for i, noise in enumerate(noises):
            seed = first + i * count + k
            yield Case(kind, f"{noise}_{seed}", seed, noise=noise)


def cases(kind: str, out: Path) -> Iterator[Case]:
    """Yields the cases of a kind. Effects with a size outside the prior range are omitted."""
    if kind == "null":
        for i in range(NULL_TANKS):
            yield Case(kind, f"{FIRST_NULL + i}", FIRST_NULL + i, compared=i < COMPARED)
    if kind == "noise":
        yield from _complete_models(kind, NOISES[1:], FIRST_NOISE, NOISE_TANKS)
    if kind == "situation":
        yield from _complete_models(kind, SITUATIONS, FIRST_SITUATION, SITUATION_TANKS)
        for noise in SITUATIONS:
            for i, effect in enumerate(IN_SITUATIONS):
                limit = limits_of(kind, i, out)[f"{effect}.{SINGLES[effect]}"]
                sized = _sized(effect, SINGLES[effect], SIZES[0] * limit, i)
                if sized:
                    name = f"{noise}_{effect}"
                    yield Case(kind, name, i, {effect: sized}, SIZES[0], noise)
    if LONGER.get(kind, kind) == "single":
        for times in SIZES if kind == "single" else SIZES[:2]:
            for i, (effect, parameter) in enumerate(SINGLES.items()):
                limit = limits_of(kind, i % TANKS, out)[f"{effect}.{parameter}"]
                sized = _sized(effect, parameter, times * limit, i % TANKS)
                if sized:
                    compared = kind == "single" and times == 3 and i < COMPARED
                    name = f"{effect}_{times}"
                    yield Case(kind, name, i % TANKS, {effect: sized}, times, compared=compared)
    if LONGER.get(kind, kind) == "double":
        for i, pair in enumerate(PAIRS):
            seed, both = i % TANKS, {}
            for k, effect in enumerate(pair):
                p = SINGLES[effect]
                distance = PAIR_SIZE * limits_of(kind, seed, out)[f"{effect}.{p}"]
                far = i % 5 == 4 and k == 0
                both[effect] = (
                    _beyond(effect, p, seed) if far else _sized(effect, p, distance, seed)
                )
            if all(both.values()):
                compared = kind == "double" and i < COMPARED
                yield Case(kind, "+".join(pair), seed, both, PAIR_SIZE, compared=compared)
    if kind in LACKING:
        for times in SIZES[:2]:
            for i, name in enumerate(LACKING[kind]):
                limit = limits_of(kind, i % TANKS, out)[f"{name}.size"]
                sized = _sized(name, "size", times * limit, i % TANKS)
                if sized:
                    compared = i < COMPARED
                    yield Case(
                        kind, f"{name}_{times}", i % TANKS, {name: sized}, times, compared=compared
                    )


def error_over_floor(
    problem: AbstractProblem, predicted: list[np.ndarray], floor: dict[str, float]
) -> float:
    """Returns the rms, over all channels, of a channel's rms error divided by its noise floor."""
    error = rms_errors(problem, predicted)
    return float(np.sqrt(np.mean([(error[c] / floor[c]) ** 2 for c in error])))


def run_case(
    case: Case, candidates: Sequence[str], compared: bool, progress: Callable[[str], None]
) -> dict[str, Any]:
    """Returns the results of the loop on a case, and of the other methods if `compared`."""
    tank, memo = tank_of(case), MemoryCache()
    start = time.perf_counter()
    # With the same names in all cases of a kind, the cases share compiled programs.
    simulated = {kind: [*SINGLES] for kind in ("single", "double", "situation", *LONGER)}
    simulated |= {kind: [*effects] for kind, effects in LACKING.items()}
    true = true_readings(tank, case.effects, simulated.get(case.kind, ()))
    if not all(np.isfinite(y).all() for y in true):
        return {"left_out": "the tank cannot be simulated with this effect"}
    found = noisy_records(tank, true, _seeded(case.seed, case.kind, case.name), case.noise)
    made, start = time.perf_counter() - start, time.perf_counter()
    outcome = close_tank_loop(tank, found, candidates, memo, progress)
    explained = outcome.verdict in (IDENTIFIED, CLASS)  # may be doubtful
    learning = learn_terms(outcome, progress) if explained or case.kind in LACKING else None
    outcome = outcome if learning is None else learning.outcome
    seconds = time.perf_counter() - start
    record = outcome_record(outcome, tank.truth) | {"seconds": seconds, "seconds_made": made}
    if learning is not None:
        files = [r.trial.file for r in found]
        record["learned"] = learned_record(learning, dict(zip(files, true, strict=True)))
        if record["learned"]["terms"]:
            complete = distance_of_complete_model(case, tank, outcome, simulated.get(case.kind, ()))
            for channel, x in record["learned"]["distance"].items():
                x["complete"] = complete[channel]
            record["verdict"] = LEARNED if record["learned"]["reaches_floor"] else PARTLY
    if not outcome.held:
        return record
    rest = part_of(outcome.problem, outcome.held)
    readings = {r.trial.file: y for r, y in zip(found, true, strict=True)}
    floor = noise_floors(rest, [readings[r.trial.file] for r in rest.records])
    record["held_out_over_floor"] = {
        "refit only": error_over_floor(rest, rest.predict(outcome.search.base.theta), floor),
        "loop": error_over_floor(rest, rest.predict(outcome.chosen.theta), floor),
    }
    record["named_by"] = {}
    if compared:
        fitted = part_of(outcome.problem, outcome.used_trials)
        s = other_methods.method_input(fitted, rest, outcome.entries, outcome.search.base)
        record["any_distortion_p"] = other_methods.any_distortion_p(s)
        for name, method in other_methods.METHODS.items():
            progress(f"other method: {name}")
            result = method(s)
            record["named_by"][name] = result.effects
            record["held_out_over_floor"][name] = error_over_floor(rest, result.predicted, floor)
        if case.kind in ("single", "double"):
            result = other_methods.oracle(s, list(case.effects))
            error = error_over_floor(rest, result.predicted, floor)
            record["held_out_over_floor"]["oracle"] = error
    record["effects_cover"] = _cover(outcome, case.effects)
    return record


def part_of(problem: AbstractProblem, chosen: Sequence[int]) -> TankProblem:
    """Returns the problem of the trials with the indices `chosen`."""
    assert isinstance(problem, TankProblem)
    return problem.part(chosen)


def interval_record(interval: tuple[float, float, float], truth: float) -> dict[str, float]:
    """Returns a fitted parameter's interval and true value."""
    value, low, high = interval
    return {"value": value, "low": low, "high": high, "truth": truth}


def outcome_record(outcome: LoopOutcome, truth: Mapping[str, float]) -> dict[str, Any]:
    """Returns the loop's verdict, and the intervals and true values of the base parameters."""
    cover = {}
    for i, p in enumerate(outcome.entries):
        if p.name in truth and not p.effect:
            cover[p.name] = interval_record(outcome.interval(i), truth[p.name])
            place = int(np.flatnonzero(outcome.final.free == i)[0])
            cover[p.name]["noise_error"] = float(np.sqrt(outcome.final.covariance[place, place]))
    return {
        "verdict": outcome.verdict,
        "effects": report.effect_records(outcome),
        "vetoed": report.veto_records(outcome),
        "where": report.residual_records(outcome),
        "noise": {c: x._asdict() for c, x in outcome.noise.items()},
        "patterns": report.whiteness_record(outcome)["patterns"],
        "candidates": [row for row in report.candidate_records(outcome) if "explained" in row],
        "parameters": cover,
        "held_out": outcome.held_out,
        "excess": {c: x.all for c, x in outcome.excess.items()},
        "converged": outcome.final.converged,
    }


def learned_record(learning: Learning, true: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Returns the learned terms, their place, and the errors without and with the function.

    `true` are the readings without noise (channels, samples) of each trial's file. `distance` is
    the rms difference between predicted and true readings in the tested trials: of the calibrated
    model without any effect (`refit`), and without and with the function.
    """
    model = learning.model
    if model is None:
        return {"reason": learning.reason, "terms": [], "reaches_floor": False}
    rest = model.dictionary.problem.part(model.tested)
    alone = part_of(learning.outcome.problem, model.tested)
    distances = {
        "refit": distances_from(alone, true, learning.outcome.search.base.theta),
        "before": distances_from(rest, true, model.dictionary.start.theta),
        "after": distances_from(rest, true, model.fit.theta),
    }
    return {
        "reason": "",
        "terms": [*model.terms, *model.fine_parts],
        "place": learning.places[0].place,
        "equal_places": learning.equal_places,
        "reaches_floor": learning.reaches_floor,
        "replaced_effects": model.dictionary.replaced,
        "errors": model.errors,
        "distance": {c: {name: x[c] for name, x in distances.items()} for c in distances["after"]},
    }


def distance_of_complete_model(
    case: Case, tank: Tank, outcome: LoopOutcome, simulated: Sequence[str]
) -> dict[str, float]:
    """Returns each channel's rms difference between a calibrated complete model and the truth.

    The tank and the noise are those of the case, but the tank has no missing effect. A part of the
    distance of a learned function is unavoidable: the calibration has an error, and the meshes of
    tank and fit differ.
    """
    true = true_readings(tank, {}, simulated)
    found = noisy_records(tank, true, _seeded(case.seed, case.kind, case.name), case.noise)
    readings = {r.trial.file: y for r, y in zip(found, true, strict=True)}
    problem = outcome.problem
    assert isinstance(problem, TankProblem)
    by_file = {r.trial.file: r for r in found}
    problem = replace(problem, records=[by_file[r.trial.file] for r in problem.records], memo=None)
    base = outcome.search.base
    fit = fit_gauss_newton(
        problem.part(outcome.used_trials), outcome.entries, base.theta, base.free
    )
    return distances_from(problem.part(outcome.held or outcome.used_trials), readings, fit.theta)


def distances_from(
    problem: TankProblem, true: Mapping[str, np.ndarray], theta: np.ndarray
) -> dict[str, float]:
    """Returns each channel's rms difference between predicted and true readings.

    `true` are the readings without noise (channels, samples) of each trial's file.
    """
    noiseless = [
        replace(r, values=np.where(np.isfinite(r.values), true[r.trial.file], np.nan))
        for r in problem.records
    ]
    return rms_errors(replace(problem, records=noiseless), problem.predict(theta))


def _cover(outcome: LoopOutcome, effects: Mapping[str, Mapping[str, float]]) -> dict[str, Any]:
    found = {}
    for i, p in enumerate(outcome.entries):
        if p.effect in effects and p.name in effects[p.effect] and i in outcome.final.free:
            found[p.label] = interval_record(outcome.interval(i), effects[p.effect][p.name])
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("what", nargs="+", choices=KINDS, help="kinds of cases to run, or table")
    add("--out", type=Path, required=True, help="folder for the results")
    add("--only", default="", help="run only cases whose name contains this text (default: all)")
    add("--alone", action="store_true", help="omit the other methods (default: run them)")
    add("--part", default="1/1", help="K/N: run only every N-th case from the K-th (default: 1/1)")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    part, parts = map(int, arguments.part.split("/"))
    prepare_jax()
    candidates = candidate_effects()
    for name in ("unknown", *(kind for kind in LACKING if kind != "outside")):
        load_effects(Path(__file__).parent / f"{name}_effects.py")
    for what in arguments.what:
        if what == "table":
            print(summary_tables(arguments.out))
            continue
        for number, case in enumerate(cases(what, arguments.out)):
            path = arguments.out / what / f"{case.name}.json"
            if path.exists() or arguments.only not in case.name or number % parts != part - 1:
                continue
            path.parent.mkdir(exist_ok=True)
            start = time.perf_counter()

            def progress(text: str, name=case.name, start=start) -> None:
                print(f"{name} {time.perf_counter() - start:5.0f} s  {text}", flush=True)

            compared = case.compared and not arguments.alone
            record = run_case(case, candidates, compared, progress)
            write_json(path, {"case": case._asdict()} | record | {"versions": versions()})
            progress(f"{record.get('verdict', 'left out')}")
            limit_memory_maps()


if __name__ == "__main__":
    main()
