"""`slider optimize`: optimises the fastest swimmer, and one tail for swimming and climbing."""

import sys
import time
from pathlib import Path
from typing import Annotated, Literal

import tyro

from slider_jax.cli.options import Folder, MaybeExperiment, ModelFile, Range, Whole
from slider_jax.errors import InputError

Address = Annotated[str, tyro.conf.arg(metavar="HOST:PORT", help_behavior_hint="")]


def _begin(coordinator: str, processes: int, process: int):
    """Start JAX on all cores of all processes; return the module that evaluates populations."""
    from slider_jax.batch.chunks import available_cores
    from slider_jax.optimise import population as evaluation

    if not 0 <= process < processes:
        raise InputError.value("--process", process, f"0 to {processes - 1}")
    if (processes > 1) != bool(coordinator):
        raise InputError(
            f"--processes {processes}: several processes need --coordinator HOST:PORT, and a "
            "single process must not have it"
        )
    evaluation.start_devices(available_cores(), coordinator, processes, process)
    return evaluation


def _check(generations: int, steps_per_stride: int, seed: int) -> None:
    if generations < 1:
        raise InputError.value("--generations", generations, "1 or more")
    if steps_per_stride < 20 or steps_per_stride % 2:
        raise InputError.value(
            "--steps-per-stride", steps_per_stride, "an even number of at least 20"
        )
    if not 0 <= seed < 2**32:
        raise InputError.value("--seed", seed, "0 to 4294967295")


class _Report:
    """Prints a line on stderr after every generation, in the first process only."""

    def __init__(self, generations: int, prints: bool):
        self._generations, self._prints, self._started = generations, prints, time.monotonic()

    def __call__(
        self, generation, seconds: float, text: str, name: str = "", generations: int = 0
    ) -> None:
        if not self._prints:
            return
        whole = generations or self._generations
        left = (whole - 1 - generation.number) * seconds
        of = f" of {name}" if name else ""
        print(
            f"{time.monotonic() - self._started:6.0f} s  {name + ': ' if name else ''}generation "
            f"{generation.number + 1} of {whole}: {text}, {generation.failed} failed; "
            f"{left:.0f} s left{of}",
            file=sys.stderr,
            flush=True,
        )


def _print_checkpoints(out: Path) -> None:
    if any(out.glob("**/checkpoint.npz")):
        print(f"checkpoints are in {out}; add --resume to continue", file=sys.stderr)


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
    """Optimise drive and tail for the largest steady swimming speed.

    The six variables are the frequency, the set pressure amplitudes of both chambers, the phase of
    the rear chamber, and the tail's length and bending stiffness EI. The command writes
    checkpoint.npz to DIR after every generation. At the end it writes optimum.json (history,
    settings, versions), optimum.png and best.toml, an experiment for `slider swim`.

    Args:
        experiment: experiment file (.toml) with the other properties of robot and water. Its first
            trial must have a square wave, which the optimised drive replaces (default: the paper's
            robot, with form drag at the head calibrated on its measured speed).
        out: folder for the results; created if missing.
        model: TOML file whose [robot], [parameters] and [[effects]] override the experiment's.
        algorithm: optimiser: the paper's genetic algorithm, gradient ascent from the best of many
            scattered designs, or CMA-ES.
        population: number of individuals in a generation.
        generations: total number of generations, including those before an interruption.
        seed: seed of the random numbers.
        resume: continue the optimisation in DIR, if there is one.
        frequency: bounds of the stride frequency, in Hz (default: 1 7).
        front: bounds of the front chamber's pressure amplitude, in Pa (default: 50e3 448e3).
        rear: bounds of the rear chamber's pressure amplitude, in Pa (default: 50e3 448e3).
        phase: bounds of the rear chamber's delay, as a fraction of a period (default: -0.5 0.5).
        tail_length: bounds of the tail's length, in m (default: 0.02 0.1).
        EI_tail: bounds of the tail's bending stiffness, in N m^2 (default: 0.001 0.038).
        steps_per_stride: number of time steps in a stride, an even number.
        coordinator: host and port where the first of several processes listens; not needed under
            SLURM (default: none).
        processes: number of processes.
        process: number of this process, counted from 0.
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
    optimiser = make_optimiser(algorithm, population, 6)
    output_folder(out)
    report = _Report(generations, evaluation.is_first())

    def on_generation(generation, seconds: float) -> None:
        report(
            generation, seconds,
            f"best {1e2 * generation.best:.2f} cm/s, mean {1e2 * generation.mean:.2f}",
        )  # fmt: skip

    try:
        found = swim_search.search_fastest(
            task, optimiser, population, generations, seed, out, resume, on_generation
        )
    except KeyboardInterrupt:
        _print_checkpoints(out)
        raise
    if evaluation.is_first():
        print("computing gradient and Hessian at the best design ...", file=sys.stderr)
        inputs = [input_file(p) for p in (experiment, model) if p is not None]
        for line in swim_search.optimum_summary(
            swim_search.write_optimum(task, found, out, inputs)
        ):
            print(line)
        print(f"wrote best.toml, optimum.json and optimum.png to {out}", file=sys.stderr)
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
    """Optimise one tail for swimming and climbing, with a drive for each task (the paper's Fig. 9).

    The objective is eta(beta) = beta E_swim/E_swim,only + (1 - beta) E_climb/E_climb,only. E_swim
    is the Froude efficiency of swimming, and E_climb is m g U/P of climbing. The command optimises
    each task alone and then each beta, starting from the best known design. It writes to DIR:
    multimodal.json, multimodal.png, and for each beta an experiment for `slider swim` and one for
    `slider climb`. Each optimisation has a folder with a checkpoint.

    Args:
        experiment: experiment file (.toml) with the other properties of robot and water. Its first
            trial must have a square wave, which the optimised drive replaces (default: the paper's
            robot, with form drag at the head calibrated on its measured speed).
        out: folder for the results; created if missing.
        model: TOML file whose [robot], [parameters] and [[effects]] override the experiment's.
        betas: number of evenly spaced values of beta from 0 (climbing alone) to 1 (swimming alone).
        algorithm: optimiser for one task alone; the optimisations between use CMA-ES.
        population: number of individuals in a generation for one task alone; the optimisations
            between use a quarter of it.
        generations: number of generations for one task alone; the optimisations between use half.
        seed: seed of the random numbers.
        resume: continue the optimisation in DIR, if there is one.
        tail_length: bounds of the tail's length, in m (default: 0.02 0.1).
        EI_tail: bounds of the tail's bending stiffness, in N m^2 (default: 0.001 0.038).
        steps_per_stride: number of time steps in a swimming stride, an even number; a climbing
            stride has a third more.
        coordinator: host and port where the first of several processes listens; not needed under
            SLURM (default: none).
        processes: number of processes.
        process: number of this process, counted from 0.
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
        raise InputError.value("--betas", betas, "2 to 101, including both ends")
    make_optimiser(algorithm, population, 6)
    effort = FrontEffort(algorithm, population, generations, seed)
    modes = TwoTasks.of(
        given_or(optimum, experiment, model), tail_length, EI_tail, steps_per_stride
    )
    output_folder(out)
    report = _Report(generations, evaluation.is_first())

    def on_generation(name: str, generation, seconds: float) -> None:
        whole = generations if name.endswith("_only") else effort.between[1]
        score = f"E_{name.split('_')[0]}" if "only" in name else "eta"
        text = f"best {score} {generation.best:.4f}, mean {generation.mean:.4f}"
        report(generation, seconds, text, name, whole)

    try:
        found = search_front(modes, betas, effort, out, resume, on_generation)
    except KeyboardInterrupt:
        _print_checkpoints(out)
        raise
    if evaluation.is_first():
        print("repeating every design on the experiment's own mesh ...", file=sys.stderr)
        inputs = [input_file(p) for p in (experiment, model) if p is not None]
        content = multimodal_report.write_front(modes, found, effort._asdict(), out, inputs)
        for line in multimodal_report.front_summary(content):
            print(line)
        print(f"wrote multimodal.json, multimodal.png and experiments to {out}", file=sys.stderr)
    evaluation.barrier("results are written")
