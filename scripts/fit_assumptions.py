"""Searches assumptions with which the paper's statements agree.

    python scripts/fit_assumptions.py results/assumptions

CMA-ES searches for three objectives: all statements, those with a fixed head, and those on
swimming. Each search runs from five random starts. Gradient steps then improve the best set on the
mesh of the table. The score is minus the mean of log(1 + miss^2). The result is joint_fit.json.
Copy it to slider_jax/statements, from which `slider published --all` takes the joint assumptions.
evaluated.jsonl contains every set of assumptions that was simulated. The searches take about 80
minutes on two cores. An interrupted run resumes when you repeat the command.
"""

import argparse
import json
import sys
from functools import partial
from pathlib import Path
from typing import Any

from slider_jax.batch.chunks import available_cores
from slider_jax.errors import InputError
from slider_jax.io.files import output_folder, provenance, write_json
from slider_jax.optimise.population import start_devices
from slider_jax.precision import enable_float64
from slider_jax.statements.quantities import FINE


def show(name: str, generation: Any, seconds: float) -> None:
    text = f"{name}: generation {generation.number + 1}, best {generation.best:.3f}"
    print(f"{text}, {seconds:.0f} s", file=sys.stderr)


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, metavar="OUT_DIR", help="folder for the results")
    given = parser.parse_args(argv)
    start_devices(available_cores())  # before the import of evosax, which starts JAX
    enable_float64()
    from slider_jax.statements.joint_fit import (
        ALL,
        COUNTED,
        Effort,
        Simulator,
        Slopes,
        ascend,
        ascent_record,
        search,
        summary,
    )

    effort = Effort()
    folder = output_folder(given.folder)
    log = folder / "evaluated.jsonl"
    simulate, searches = Simulator(log=log), []
    for objective, start in effort.searches():
        place = folder / f"{objective.replace(' ', '_')}_{start}"
        name = f"{objective}, start {start}"
        result = search(simulate, objective, start, effort, place, partial(show, name))
        searches.append((objective, start, result))
    with log.open(encoding="utf-8") as file:
        evaluated = [json.loads(line) for line in file]
    found = [(x, start) for objective, start, x in searches if objective == ALL]
    best, start = max(found, key=lambda pair: pair[0].score)
    ascent = ascend(
        Slopes(FINE), Simulator(FINE), best.best, COUNTED, effort.steps,
        lambda step, score: print(f"gradient step {step + 1}: {score:.3f}", file=sys.stderr),
    )  # fmt: skip
    content = summary(searches, ascent_record(ALL, start, ascent), evaluated, effort)
    write_json(folder / "joint_fit.json", content | {"provenance": provenance()})
    print(f"wrote joint_fit.json to {folder}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except InputError as error:
        print(f"fit_assumptions: {error}", file=sys.stderr)
        sys.exit(2)
