"""`slider optimize`: tail and gait of a swimmer, and one tail to swim and to climb with."""

import sys
import time
from pathlib import Path
from typing import Annotated, Literal

import tyro

from slider_jax.cli.options import Folder, MaybeExperiment, ModelFile, Range, Whole
from slider_jax.errors import InputError

Address = Annotated[str, tyro.conf.arg(metavar="HOST:PORT")]


def _begin(coordinator: str, processes: int, process: int):
    """Start JAX on all cores of all processes; returns the module that knows them."""
    from slider_jax.batch.chunks import available_cores
    from slider_jax.optimise import population as evaluation

    if not 0 <= process < processes:
        raise InputError.value("--process", process, f"0 to {processes - 1}")
    if (processes > 1) != bool(coordinator):
        raise InputError(
            f"--processes {processes}: more than one need --coordinator HOST:PORT, and one has none"
        )
    evaluation.start_devices(available_cores(), coordinator, processes, process)
    return evaluation


def _check(generations: int, steps_per_stride: int, seed: int) -> None:
    if generations < 1:
        raise InputError.value("--generations", generations, "1 or more")
    if steps_per_stride < 20 or steps_per_stride % 2:
        raise InputError.value("--steps-per-stride", steps_per_stride, "an even number from 20")
    if not 0 <= seed < 2**32:
        raise InputError.value("--seed", seed, "0 to 4294967295")


class _Report:
    """A line on stderr after every generation, of the process that speaks."""

    def __init__(self, generations: int, speaks: bool):
        self._generations, self._speaks, self._begun = generations, speaks, time.monotonic()

    def __call__(
        self, generation, seconds: float, words: str, name: str = "", generations: int = 0
    ) -> None:
        if not self._speaks:
            return
        whole = generations or self._generations
        left = (whole - 1 - generation.number) * seconds
        of = f" of {name}" if name else ""
        print(
            f"{time.monotonic() - self._begun:6.0f} s  {name + ': ' if name else ''}generation "
            f"{generation.number + 1} of {whole}: {words}, {generation.failed} failed; "
            f"{left:.0f} s left{of}",
            file=sys.stderr,
            flush=True,
        )


def _kept(out: Path) -> None:
    if any(out.glob("**/checkpoint.npz")):
        print(f"what was found is kept in {out}; add --resume to go on", file=sys.stderr)


def optimize_swim(
    experiment: MaybeExperiment = None,
    *,
    out: Folder,
    model: ModelFile = None,
    algorithm: Literal["genetic", "gradient", "cma-es"] = "genetic",
    population: Whole = 112,
    generations: Whole = 30,
    seed: Whole = 0,
    resume: bool = False,
    frequency: Range = None,
    front: Range = None,
    rear: Range = None,
    phase: Range = None,
    tail_length: Range = None,
    EI_tail: Range = None,
    steps_per_stride: Whole = 96,
    coordinator: Address = "",
    processes: Whole = 1,
    process: Whole = 0,
) -> None:
    """Seek the fastest steady swimmer over drive and tail.

    Six variables: frequency [Hz], amplitudes of the set pressure in front and rear chamber [Pa],
    phase of the rear one, length [m] and EI [N m^2] of the tail. DIR gets checkpoint.npz after
    every generation, and at the end best.toml, an experiment that `slider swim` takes,
    optimum.json (history, settings, versions) and optimum.png.

    Args:
        experiment: file (.toml) that gives the rest of the robot and water; its first trial is to
            have a square wave, in whose place the drive that is sought comes. By default the
            paper's robot, with form drag at the head that was calibrated on its measured speed.
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
    evaluation = _begin(coordinator, processes, process)
    from slider_jax.io.files import input_file, output_folder
    from slider_jax.optimise import fastest_swimmer as swim_search
    from slider_jax.optimise.optimiser import make_optimiser
    from slider_jax.swimming.paper_optimum import given_or, optimum

    _check(generations, steps_per_stride, seed)
    bounds = {"frequency": frequency, "front": front, "rear": rear, "phase": phase,
              "tail_length": tail_length, "EI_tail": EI_tail}  # fmt: skip
    task = swim_search.Task.of(given_or(optimum, experiment, model), bounds, steps_per_stride)
    algorithm_of = make_optimiser(algorithm, population, 6)
    output_folder(out)
    report = _Report(generations, evaluation.is_first())

    def said(generation, seconds: float) -> None:
        report(
            generation, seconds,
            f"best {1e2 * generation.best:.2f} cm/s, mean {1e2 * generation.mean:.2f}",
        )  # fmt: skip

    try:
        found = swim_search.search_fastest(
            task, algorithm_of, population, generations, seed, out, resume, said
        )
    except KeyboardInterrupt:
        _kept(out)
        raise
    if evaluation.is_first():
        print("gradient and Hessian at the best ...", file=sys.stderr)
        inputs = [input_file(p) for p in (experiment, model) if p is not None]
        for line in swim_search.optimum_summary(
            swim_search.write_optimum(task, found, out, inputs)
        ):
            print(line)
        print(f"best.toml, optimum.json and optimum.png are in {out}", file=sys.stderr)
    evaluation.barrier("results are written")


def optimize_multimodal(
    experiment: MaybeExperiment = None,
    *,
    out: Folder,
    model: ModelFile = None,
    betas: Whole = 7,
    algorithm: Literal["genetic", "cma-es"] = "genetic",
    population: Whole = 112,
    generations: Whole = 30,
    seed: Whole = 0,
    resume: bool = False,
    tail_length: Range = None,
    EI_tail: Range = None,
    steps_per_stride: Whole = 96,
    coordinator: Address = "",
    processes: Whole = 1,
    process: Whole = 0,
) -> None:
    """Seek one tail for swimming and climbing, each with a drive of its own: the paper's Fig. 9.

    eta(beta) = beta E_swim/E_swim,only + (1 - beta) E_climb/E_climb,only, with the Froude
    efficiency of swimming and m g U/P of climbing. First each task alone, then along beta from the
    best that is known. DIR gets a folder with a checkpoint for every search, and at the end
    multimodal.json, multimodal.png, and for every beta two experiments that `slider swim` and
    `slider climb` take.

    Args:
        experiment: file (.toml) that gives the rest of the robot and water; its first trial is to
            have a square wave, in whose place the drive that is sought comes. By default the
            paper's robot, with form drag at the head that was calibrated on its measured speed.
        out: folder for the results; made if missing.
        model: TOML file whose [robot], [parameters] and [[effects]] override the experiment's.
        betas: evenly spread values from 0, climbing alone, to 1, swimming alone.
        algorithm: of the searches for one task alone; along beta it is CMA-ES.
        population: members of a generation of a task alone; along beta a quarter of them.
        generations: of a task alone; along beta half as many.
        seed: of all that is drawn.
        resume: go on with the searches that DIR holds, if any.
        tail_length: bounds [m].
        EI_tail: bounds [N m^2].
        steps_per_stride: time steps of a swimming stride; a climbing one has a third more.
        coordinator: of several processes, where the first of them listens; not needed under SLURM.
        processes: how many there are.
        process: which of them this is, from 0.
    """
    evaluation = _begin(coordinator, processes, process)
    from slider_jax.io.files import input_file, output_folder
    from slider_jax.optimise import report as multimodal_report
    from slider_jax.optimise.optimiser import make_optimiser
    from slider_jax.optimise.pareto_front import FrontEffort, search_front
    from slider_jax.optimise.two_tasks import TwoTasks
    from slider_jax.swimming.paper_optimum import given_or, optimum

    _check(generations, steps_per_stride, seed)
    if not 2 <= betas <= 101:
        raise InputError.value("--betas", betas, "2 to 101: both ends, and values between")
    make_optimiser(algorithm, population, 6)
    effort = FrontEffort(algorithm, population, generations, seed)
    modes = TwoTasks.of(
        given_or(optimum, experiment, model), tail_length, EI_tail, steps_per_stride
    )
    output_folder(out)
    report = _Report(generations, evaluation.is_first())

    def said(name: str, generation, seconds: float) -> None:
        whole = generations if name.endswith("_only") else effort.between[1]
        score = f"E_{name.split('_')[0]}" if "only" in name else "eta"
        words = f"best {score} {generation.best:.4f}, mean {generation.mean:.4f}"
        report(generation, seconds, words, name, whole)

    try:
        found = search_front(modes, betas, effort, out, resume, said)
    except KeyboardInterrupt:
        _kept(out)
        raise
    if evaluation.is_first():
        print("every design once more, on the experiment's own mesh ...", file=sys.stderr)
        inputs = [input_file(p) for p in (experiment, model) if p is not None]
        content = multimodal_report.write_front(modes, found, effort._asdict(), out, inputs)
        for line in multimodal_report.front_summary(content):
            print(line)
        print(f"multimodal.json, multimodal.png and experiments are in {out}", file=sys.stderr)
    evaluation.barrier("results are written")
