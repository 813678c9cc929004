"""`slider optimize swim`: tail and gait of a swimmer, by the paper's genetic algorithm."""

import sys
import time
from typing import Annotated, Literal

import tyro

from slider_jax.cli.options import Folder, MaybeExperiment, ModelFile, Whole
from slider_jax.errors import InputError

Pair = Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="LOW HIGH")]


def swim(
    experiment: MaybeExperiment = None,
    *,
    out: Folder,
    model: ModelFile = None,
    algorithm: Literal["genetic", "gradient", "cma-es"] = "genetic",
    population: Whole = 112,
    generations: Whole = 30,
    seed: Whole = 0,
    resume: bool = False,
    frequency: Pair = None,
    front: Pair = None,
    rear: Pair = None,
    phase: Pair = None,
    tail_length: Pair = None,
    EI_tail: Pair = None,
    steps_per_stride: Whole = 96,
    coordinator: Annotated[str, tyro.conf.arg(metavar="HOST:PORT")] = "",
    processes: Whole = 1,
    process: Whole = 0,
) -> None:
    """Seek the fastest steady swimmer over drive and tail.

    Six variables: frequency [Hz], amplitudes of the set pressure in front and rear chamber [Pa],
    phase of the rear one, length [m] and EI [N m^2] of the tail. DIR gets checkpoint.npz after
    every generation, and at the end best.toml, an experiment that `slider swim` takes,
    optimum.json (history, settings, versions) and optimum.png.

    Args:
        experiment: file (.toml) that gives the rest of the robot and water; by default the paper's
            robot, with form drag at the head that was calibrated on its measured speed.
        out: folder for the results; made if missing.
        model: TOML file whose [robot], [parameters] and [[effects]] override the experiment's.
        algorithm: the paper's genetic algorithm; the best of spread members that climb along their
            gradients; or CMA-ES.
        population: members of a generation.
        generations: how many are evaluated, those before a stop among them.
        seed: of all that is drawn.
        resume: go on with the search that DIR holds, if any.
        frequency: bounds [Hz].
        front: bounds [Pa].
        rear: bounds [Pa].
        phase: bounds, of a period.
        tail_length: bounds [m].
        EI_tail: bounds [N m^2].
        steps_per_stride: time steps of a stride.
        coordinator: of several processes, where the first of them listens; not needed under SLURM.
        processes: how many there are.
        process: which of them this is, from 0.
    """
    from slider_jax import evaluation
    from slider_jax.batch import available_cores

    if not 0 <= process < processes:
        raise InputError.value("--process", process, f"0 to {processes - 1}")
    if (processes > 1) != bool(coordinator):
        raise InputError(
            f"--processes {processes}: more than one need --coordinator HOST:PORT, and one has none"
        )
    evaluation.begin(available_cores(), coordinator, processes, process)
    from slider_jax import swim_search
    from slider_jax.files import output_folder
    from slider_jax.paper_swimmer import given_or_optimum
    from slider_jax.provenance import input_file
    from slider_jax.searchers import searcher

    if generations < 1:
        raise InputError.value("--generations", generations, "1 or more")
    if steps_per_stride < 20 or steps_per_stride % 2:
        raise InputError.value("--steps-per-stride", steps_per_stride, "an even number from 20")
    if not 0 <= seed < 2**32:
        raise InputError.value("--seed", seed, "0 to 4294967295")
    bounds = {"frequency": frequency, "front": front, "rear": rear, "phase": phase,
              "tail_length": tail_length, "EI_tail": EI_tail}  # fmt: skip
    task = swim_search.Task.of(given_or_optimum(experiment, model), bounds, steps_per_stride)
    algorithm_of = searcher(algorithm, population, 6)
    output_folder(out)
    begun = time.monotonic()

    def said(generation, seconds: float) -> None:
        if not evaluation.is_first():
            return
        left = (generations - 1 - generation.number) * seconds
        print(
            f"{time.monotonic() - begun:6.0f} s  generation {generation.number + 1} of "
            f"{generations}: best {1e2 * generation.best:.2f} cm/s, "
            f"mean {1e2 * generation.mean:.2f}, "
            f"{generation.failed} failed; {left:.0f} s left",
            file=sys.stderr,
            flush=True,
        )

    try:
        found = swim_search.search(
            task, algorithm_of, population, generations, seed, out, resume, said
        )
    except KeyboardInterrupt:
        if (out / "checkpoint.npz").exists():
            print(f"{out / 'checkpoint.npz'} is kept; add --resume to go on", file=sys.stderr)
        raise
    if evaluation.is_first():
        inputs = [input_file(p) for p in (experiment, model) if p is not None]
        for line in swim_search.words(swim_search.write(task, found, out, inputs)):
            print(line)
        print(f"best.toml, optimum.json and optimum.png are in {out}", file=sys.stderr)
    evaluation.together("results are written")
