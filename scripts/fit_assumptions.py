"""Searches assumptions with which the paper's statements agree.

    python scripts/fit_assumptions.py results/assumptions

CMA-ES searches for three objectives: all statements, those with a fixed head, and those on
swimming. Each search runs from five random starts. A last search refines the best set on the mesh
of the table. The score is minus the mean of log(1 + miss^2). The result is joint_fit.json. Copy it
to slider_jax/statements, from which `slider published --all` takes the joint assumptions.
evaluated.jsonl contains every set of assumptions that was simulated. The searches take about an
hour on two cores. An interrupted run resumes when you repeat the command.

    python scripts/fit_assumptions.py results/gradients --gradients

This command improves the stored best sets by gradient steps instead, on the mesh of the table. The
result is the stored joint_fit.json with the key `gradients`. A step takes about half a minute.
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

STEPS = 12
"""Largest number of gradient steps from a set."""


def show(name: str, generation: Any, seconds: float) -> None:
    text = f"{name}: generation {generation.number + 1}, best {generation.best:.3f}"
    print(f"{text}, {seconds:.0f} s", file=sys.stderr)


def with_gradients(folder: Path) -> dict[str, Any]:
    """Returns the stored result with gradient steps from its best sets; each is in a file."""
    from slider_jax.statements.assumptions import Assumptions, to_unit
    from slider_jax.statements.joint_fit import (
        ALL,
        COUNTED,
        Simulator,
        Slopes,
        ascend,
        ascent_record,
    )
    from slider_jax.statements.verdicts import joint_fit

    stored = joint_fit()
    starts = [x for x in (*stored["searches"], stored["refined"]) if x["objective"] == ALL]
    slopes, simulate, records = Slopes(FINE), Simulator(FINE), []
    for x in starts:
        name = "refined" if x["start"] is None else f"start_{x['start']}"
        path = folder / f"gradients_{name}.json"
        if not path.exists():
            print(f"gradient steps from {name}", file=sys.stderr)
            found = ascend(
                slopes, simulate, to_unit(Assumptions(**x["assumptions"])), COUNTED, STEPS,
                lambda step, score: print(f"  step {step + 1}, {score:.4f}", file=sys.stderr),
            )  # fmt: skip
            write_json(path, ascent_record(ALL, x["start"], found))
        records.append(json.loads(path.read_text(encoding="utf-8")))
    return stored | {"gradients": records}


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, metavar="OUT_DIR", help="folder for the results")
    parser.add_argument(
        "--gradients", action="store_true", help="improve the stored best sets by gradient steps"
    )
    given = parser.parse_args(argv)
    start_devices(available_cores())  # before the import of evosax, which starts JAX
    enable_float64()
    from slider_jax.statements.joint_fit import ALL, Effort, Simulator, search, summary

    effort = Effort()
    folder = output_folder(given.folder)
    if given.gradients:
        write_json(folder / "joint_fit.json", with_gradients(folder))
        print(f"wrote joint_fit.json to {folder}", file=sys.stderr)
        return 0
    log = folder / "evaluated.jsonl"
    simulate, searches = Simulator(log=log), []
    for objective, start in effort.searches():
        place = folder / f"{objective.replace(' ', '_')}_{start}"
        name = f"{objective}, start {start}"
        found = search(simulate, objective, start, effort, place, partial(show, name))
        searches.append((objective, start, found))
    with log.open(encoding="utf-8") as file:
        evaluated = [json.loads(line) for line in file]
    fine = Simulator(FINE)
    best = max((x for objective, _, x in searches if objective == ALL), key=lambda x: x.score).best
    narrow = Effort(population=effort.refining_population, generations=effort.refining)
    refined = search(fine, ALL, 0, narrow, folder / "refined", partial(show, "refined"), best)
    (reached,) = fine(refined.best[None])
    content = summary(searches, (refined, reached), evaluated, effort)
    write_json(folder / "joint_fit.json", content | {"provenance": provenance()})
    print(f"wrote joint_fit.json to {folder}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except InputError as error:
        print(f"fit_assumptions: {error}", file=sys.stderr)
        sys.exit(2)
