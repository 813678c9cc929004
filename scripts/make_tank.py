"""Writes a synthetic tank experiment with a known effect, to try `slider close-loop` without data.

    python scripts/make_tank.py results/tank --effect valve_delay.delay=0.02
    slider close-loop results/tank/experiment.toml --out results/found

The data contain the effect, but the experiment file does not name this effect. The script samples
the parameters of the base model. DIR/truth.json contains all true values. `slider close-loop` does
not read that file. `slider effects` lists the effects.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

from calibration.measurements.synthetic import (
    Truth,
    random_base_parameters,
    random_trials,
    write_tank,
)
from slider_jax.effects.library import LIBRARY
from slider_jax.errors import InputError, SolverError
from slider_jax.io.files import write_json
from slider_jax.precision import enable_float64


def effects_of(given: list[str]) -> dict[str, dict[str, float]]:
    """Returns the parameters of each effect, from texts such as "valve_delay.delay=0.02"."""
    found: dict[str, dict[str, float]] = {}
    for text in given:
        label, _, number = text.partition("=")
        effect, _, name = label.partition(".")
        if effect not in LIBRARY:
            raise InputError(
                f"--effect {text}: unknown effect {effect}; `slider effects` lists them"
            )
        priors = LIBRARY[effect].priors() | LIBRARY[effect].shapes()
        if name not in priors:
            raise InputError(f"--effect {text}: allowed parameters are {', '.join(priors)}")
        try:
            value = float(number)
        except ValueError:
            raise InputError(f"--effect {text}: allowed EFFECT.PARAMETER=NUMBER") from None
        low, high = priors[name].low, priors[name].high
        if not low <= value <= high:
            raise InputError(f"--effect {text}: allowed {low:g} to {high:g} {priors[name].unit}")
        found.setdefault(effect, {})[name] = value
    return found


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("folder", type=Path, metavar="DIR", help="folder for the experiment")
    add("--effect", action="append", default=[], metavar="EFFECT.PARAMETER=NUMBER",
        help="effect in the data and its size in SI units; repeat the option for further effects "
        "(default: none)")  # fmt: skip
    add("--seed", type=int, default=0, help="seed of the random numbers (default: 0)")
    add("--trials", type=int, default=8, help="number of trials (default: 8)")
    add("--seconds", type=float, default=1.0, help="factor of all durations (default: 1)")
    given = parser.parse_args(argv)
    enable_float64()
    base = random_base_parameters(np.random.default_rng(given.seed))
    truth = Truth(base, effects_of(given.effect))
    runs = random_trials(given.seed, given.trials, given.seconds)
    path = write_tank(given.folder, truth, runs, given.seed)
    write_json(given.folder / "truth.json", truth._asdict())
    print(f"wrote {path} and {len(runs)} trials; true values: {given.folder / 'truth.json'}")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (InputError, SolverError) as error:
        print(f"make_tank: {error}", file=sys.stderr)
        sys.exit(2)
