"""How well the loop says what a model lacks: tanks with a known answer, and other ways beside it.

    python benchmarks/loop.py null coverage single double outside --out DIR
    python benchmarks/loop.py table --out DIR

Every case is a file under DIR, written when it is done: a run that was stopped goes on, and several
kinds may be asked for at once. `table` sums up what is there. Needs scikit-learn for the rivals.
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
import rivals
from strangers import STRANGERS
from summary import summed_up
from tanks import closed, draw, limits, noisy, problem_of, simulated

from calibration.discrepancy.close_loop import LoopOutcome, choose_held_out
from calibration.inference.goodness import noise_floors, rms_errors
from calibration.inference.problem import AbstractProblem
from calibration.model.extended import candidates
from slider_jax.effects.library import LIBRARY
from slider_jax.io.files import versions, write_json
from slider_jax.precision import enable_float64

SIZED = {
    "valve_delay": "delay", "fill_vent_asymmetry": "ratio", "leakage": "leak",
    "choked_flow": "inverse", "line_lag": "tau", "actuator_hysteresis": "amplitude",
    "body_stiffness": "x", "cubic_elasticity": "b", "clamp_compliance": "compliance",
    "tangential_friction": "C_t", "tip_mass": "mass", "tank_current": "U_x",
    "force_crosstalk": "angle", "camera_delay": "delay",
    "chamber_mismatch": "difference", "pressure_sensor_lag": "tau",
}  # fmt: skip
"""Effects, with the parameter that sets their size."""
SIZES = (1, 3, 10)
"""Times the detection limit."""
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
WITH_RIVALS = (3, PAIR_SIZE)
"""Sizes of the effects of which the other ways speak too."""
TANKS = 3
"""Tanks that the cases with an effect share."""


class Case(NamedTuple):
    """A tank with effects in it."""

    kind: str
    name: str
    seed: int
    """Of the tank."""
    effects: Mapping[str, Mapping[str, float]]
    size: float = 0.0
    stranger: str = ""


def sizes_of(seed: int, out: Path) -> dict[tuple[str, str], float]:
    """Detection limits in a tank, kept on file."""
    path = out / f"limits_{seed}.json"
    if not path.exists():
        print(f"detection limits of tank {seed}", flush=True)
        write_json(path, {f"{e}.{p}": x for (e, p), x in limits(seed).items()})
    found = json.loads(path.read_text())
    return {tuple(k.split(".")): np.inf if x is None else x for k, x in found.items()}


def _sized(effect: str, parameter: str, times: float, seed: int, out: Path) -> dict[str, float]:
    """An effect's parameter at so many times its limit, of drawn sign; empty outside its range."""
    prior = LIBRARY[effect].priors()[parameter]
    distance = times * sizes_of(seed, out)[effect, parameter]
    rng = np.random.default_rng([seed, sorted(LIBRARY).index(effect)])
    signs = [-1.0, 1.0] if rng.random() < 0.5 else [1.0, -1.0]
    for sign in signs:
        if prior.low <= prior.null + sign * distance <= prior.high:
            return {parameter: prior.null + sign * distance}
    return {}


def cases(kind: str, out: Path) -> Iterator[Case]:
    """The cases of a kind; one whose size lies outside what is believed of it is left out."""
    if kind == "single":
        for times in reversed(SIZES):
            for i, (effect, parameter) in enumerate(SIZED.items()):
                sized = _sized(effect, parameter, times, i % TANKS, out)
                if sized:
                    yield Case(kind, f"{effect}_{times}", i % TANKS, {effect: sized}, times)
    if kind == "double":
        for i, pair in enumerate(PAIRS):
            both = {e: _sized(e, SIZED[e], PAIR_SIZE, i % TANKS, out) for e in pair}
            if all(both.values()):
                yield Case(kind, "+".join(pair), i % TANKS, both, PAIR_SIZE)
    if kind == "outside":
        for i, name in enumerate(STRANGERS):
            yield Case(kind, name, i % TANKS, {}, stranger=name)


def ratio(problem: AbstractProblem, predicted: list[np.ndarray], floor: dict[str, float]) -> float:
    """rms over the channels of each channel's rms error over its floor."""
    error = rms_errors(problem, predicted)
    return float(np.sqrt(np.mean([(error[c] / floor[c]) ** 2 for c in error])))


def run(case: Case, compared: bool, progress) -> dict[str, Any]:
    """Close the loop on a case, and let the rivals speak where it is `compared`."""
    tank = draw(case.seed)
    own = [STRANGERS[case.stranger].effect()] if case.stranger else []
    begun = time.perf_counter()
    true = simulated(tank, case.effects, own)
    if not all(np.isfinite(y).all() for y in true):
        return {"left_out": "the tank cannot be simulated with this effect"}
    found = noisy(tank, true, noise_seed(case))
    held = choose_held_out(found)
    made, memo = time.perf_counter() - begun, null.Kept()
    begun = time.perf_counter()
    outcome = closed(tank, found, memo, progress)
    seconds = time.perf_counter() - begun
    told = null.summary(outcome, tank.truth) | {"seconds": seconds, "seconds_made": made}
    names = tuple(candidates())
    laid = problem_of(tank, names, memo)
    seen = laid([r for i, r in enumerate(found) if i not in held])
    rest = laid([found[i] for i in held])
    floor = noise_floors(rest, [true[i] for i in held])
    told["held_out_over_floor"] = {
        "refit only": ratio(rest, rest.predict(outcome.search.base.theta), floor),
        "loop": ratio(rest, rest.predict(outcome.chosen.theta), floor),
    }
    told["named_by"] = {}
    if compared and case.size in WITH_RIVALS:
        s = rivals.begin(seen, rest, outcome.entries, outcome.search.base)
        ways = {"sparse": rivals.sparse, "stepwise": rivals.stepwise, "gp": rivals.gp}
        for name, way in ways.items():
            progress(f"rival: {name}")
            said = way(s)
            told["named_by"][name] = said.effects
            told["held_out_over_floor"][name] = ratio(rest, said.predicted, floor)
        said = rivals.oracle(s, list(case.effects))
        told["held_out_over_floor"]["oracle"] = ratio(rest, said.predicted, floor)
    if case.effects:
        told["effects_cover"] = _cover(outcome, case.effects)
    return told


def noise_seed(case: Case) -> int:
    """A seed that is a case's own."""
    digest = hashlib.sha256(f"{case.seed} {case.kind} {case.name}".encode()).digest()
    return int.from_bytes(digest[:7])


def _cover(outcome: LoopOutcome, effects: Mapping[str, Mapping[str, float]]) -> dict[str, Any]:
    found = {}
    for i, p in enumerate(outcome.entries):
        if p.effect in effects and p.name in effects[p.effect] and i in outcome.final.free:
            found[p.label] = null.told(outcome.interval(i), effects[p.effect][p.name])
    return found


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    asked.add_argument("what", nargs="+", choices=KINDS)
    asked.add_argument("--out", type=Path, required=True)
    asked.add_argument("--only", default="", help="cases whose name holds this")
    asked.add_argument("--alone", action="store_true", help="without the other ways: half the time")
    given = asked.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    enable_float64()

    def work(path: Path, make) -> None:
        if path.exists() or given.only not in path.name:
            return
        path.parent.mkdir(exist_ok=True)
        begun = time.perf_counter()

        def progress(text: str) -> None:
            print(f"{path.stem} {time.perf_counter() - begun:5.0f} s  {text}", flush=True)

        write_json(path, make(progress) | {"versions": versions()})

    for what in given.what:
        if what == "table":
            print(summed_up(given.out))
        elif what == "null":
            for seed in range(null.SEED, null.SEED + null.TANKS):
                work(given.out / what / f"{seed}.json", lambda p, s=seed: null.replicates(s, p))
        elif what == "coverage":
            for seed in range(null.FIRST, null.FIRST + null.COVERED):
                work(given.out / what / f"{seed}.json", lambda p, s=seed: null.covered(s, p))
        else:
            for case in cases(what, given.out):
                about = {"case": case._asdict()}
                path = given.out / what / f"{case.name}.json"
                work(path, lambda p, c=case, a=about: a | run(c, not given.alone, p))


if __name__ == "__main__":
    main()
