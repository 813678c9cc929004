"""A tank experiment with a known answer, to try the loop on before your own data are there.

    python scripts/make_tank.py results/tank --effect valve_delay.delay=0.02
    slider close-loop results/tank/experiment.toml --out results/found

The effect is in the data and not in the file. Parameters of the base model are drawn; what was put
in is written to DIR/truth.json, which the loop does not read. `slider effects` lists what there is.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

from calibration.measurements.synthetic import Truth, base_parameters, trials, write_tank
from slider_jax.effects.library import LIBRARY
from slider_jax.errors import InputError, SolverError
from slider_jax.io.files import write_json
from slider_jax.precision import enable_float64


def effects_of(given: list[str]) -> dict[str, dict[str, float]]:
    """Parameters by effect, from texts like "valve_delay.delay=0.02"."""
    found: dict[str, dict[str, float]] = {}
    for text in given:
        label, _, number = text.partition("=")
        effect, _, name = label.partition(".")
        if effect not in LIBRARY:
            raise InputError(f"--effect {text}: unknown effect {effect}; see slider effects")
        priors = LIBRARY[effect].priors()
        if name not in priors:
            raise InputError(f"--effect {text}: {effect} has {', '.join(priors)}")
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
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    asked.add_argument("folder", type=Path, metavar="DIR")
    asked.add_argument("--effect", action="append", default=[], metavar="EFFECT.PARAMETER=NUMBER")
    asked.add_argument("--seed", type=int, default=0)
    asked.add_argument("--trials", type=int, default=8)
    asked.add_argument("--seconds", type=float, default=1.0, help="scale of the durations")
    given = asked.parse_args(argv)
    enable_float64()
    base = base_parameters(np.random.default_rng(given.seed))
    truth = Truth(base, effects_of(given.effect))
    runs = trials(given.seed, given.trials, given.seconds)
    path = write_tank(given.folder, truth, runs, given.seed)
    write_json(given.folder / "truth.json", truth._asdict())
    print(f"{path} and {len(runs)} trials; the answer is in {given.folder / 'truth.json'}")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (InputError, SolverError) as error:
        print(f"make_tank: {error}", file=sys.stderr)
        sys.exit(2)
