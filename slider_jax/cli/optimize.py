"""`slider optimize`: optimises a swimmer, one tail for two tasks, or the way to the wall."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from slider_jax.cli.commands import function_of
from slider_jax.cli.options import EffectFiles, Folder, MaybeExperiment, ModelFile, Range, Whole
from slider_jax.errors import InputError

Address = Annotated[str, tyro.conf.arg(metavar="HOST:PORT", help_behavior_hint="")]


@dataclass(frozen=True)
class SearchOptions:
    """Options of all optimisations.

    Args:
        experiment: experiment file (.toml) with the properties of robot and water that are not
            optimised. The first trial must have a square wave (default: the paper's robot, with
            the head's form drag fitted to the measured speed). `transition` needs a table
            [transition] instead; its schedule is replaced.
        model: TOML file. Its keys of [robot] and [parameters] replace the experiment's keys, and
            its [[effects]] are added.
        population: number of individuals in a generation. In `multimodal`, an optimisation that
            starts from a known design uses a quarter of this number.
        generations: total number of generations, including generations before an interruption. In
            `multimodal`, an optimisation that starts from a known design uses half of this number.
            In `transition`, each part alone uses half of this number.
        seed: seed of the random numbers.
        resume: continue an interrupted optimisation in DIR.
        tail_length: bounds of the tail's length, in m (default: 0.02 0.1).
        EI_tail: bounds of the tail's bending stiffness, in N m^2 (default: 0.001 0.038).
        steps_per_stride: number of time steps in a swimming stride, an even number. A climbing
            stride has one third more time steps than this number. `transition` uses numerics.step
            instead.
        coordinator: host and port at which the first of several connected processes listens.
            Processes that share DIR need no connection (default: none).
        processes: number of connected processes.
        process: number of this process among the connected processes, counted from 0.
    """

    experiment: MaybeExperiment = None
    model: ModelFile = None
    population: Whole = 112
    generations: Whole = 30
    seed: Whole = 0
    resume: bool = False
    tail_length: Range = None
    EI_tail: Range = None
    steps_per_stride: Whole = 96
    coordinator: Address = ""
    processes: Whole = 1
    process: Whole = 0
    effects: EffectFiles = ()

    def start(self, default: str = "slider_jax.swimming.paper_optimum:optimum"):
        """Checks the options, starts JAX on all cores and returns the experiment.

        `default` is the function, written as `module:function`, that returns the experiment if none
        is given.
        """
        from slider_jax.batch.chunks import available_cores
        from slider_jax.optimise.population import start_devices

        if not 0 <= self.process < self.processes:
            raise InputError.value("--process", self.process, f"0 to {self.processes - 1}")
        if (self.processes > 1) != bool(self.coordinator):
            raise InputError(
                f"--processes {self.processes}: several processes need --coordinator HOST:PORT; "
                "omit --coordinator for a single process"
            )
        if self.generations < 1:
            raise InputError.value("--generations", self.generations, "1 or more")
        steps = self.steps_per_stride
        if steps < 20 or steps % 2:
            raise InputError.value("--steps-per-stride", steps, "an even number of at least 20")
        if not 0 <= self.seed < 2**32:
            raise InputError.value("--seed", self.seed, "0 to 4294967295")
        start_devices(available_cores(), self.coordinator, self.processes, self.process)
        from slider_jax.effects.library import load_all_effects
        from slider_jax.swimming.paper_optimum import given_or

        load_all_effects(self.effects)  # computes with JAX, so it follows `start_devices`
        return given_or(function_of(default), self.experiment, self.model)

    def inputs(self) -> list[dict[str, Any]]:
        """Returns paths and checksums of the input files."""
        from slider_jax.io.files import input_files

        return input_files(self.experiment, self.model)


def _reporter() -> Callable[..., None]:
    """Returns a function that prints a line after every generation, in the first process only."""
    from slider_jax.cli.progress import timed_printer
    from slider_jax.optimise.population import is_first

    print_timed = timed_printer()

    def report(generation, seconds: float, text: str, whole: int, name: str = "") -> None:
        if is_first():
            remaining = f"{(whole - 1 - generation.number) * seconds:.0f} s left"
            print_timed(
                f"{name and f'{name}: '}generation {generation.number + 1} of {whole}: {text}, "
                f"{generation.failed} failed; {remaining}{name and f' of {name}'}"
            )

    return report


def _writer(out: Path, file: str) -> Callable[[Callable[[], None]], None]:
    """Returns a function that calls `write()` in one of the processes that share the folder.

    `write` replaces `file`. The other processes wait until this file has changed.
    """
    from slider_jax.io.sharing import SharedFolder
    from slider_jax.optimise.population import SCORES, barrier, is_first

    def time_of_file() -> int:
        return (out / file).stat().st_mtime_ns if (out / file).exists() else 0

    before = time_of_file()

    def write_in_one_process(write: Callable[[], None]) -> None:
        if is_first():  # of connected processes
            with SharedFolder(out / SCORES) as shared:
                shared.alone("result", lambda: time_of_file() != before, write)
        barrier("results are written")

    return write_in_one_process


@contextmanager
def _resumable(out: Path) -> Iterator[None]:
    """Prints how to resume if the user interrupts the command after the first checkpoint."""
    try:
        yield
    except KeyboardInterrupt:
        if any(out.glob("**/checkpoint.npz")):
            print(f"checkpoints are in {out}; add --resume to continue", file=sys.stderr)
        raise


def optimize_swim(
    search: SearchOptions = SearchOptions(),
    *,
    out: Folder,
    algorithm: Literal["genetic", "gradient", "cma-es"] = "genetic",
    frequency: Range = None,
    front: Range = None,
    rear: Range = None,
    phase: Range = None,
) -> None:
    """Optimises drive and tail for the largest steady swimming speed.

    The six variables are the frequency, the set pressure amplitudes of the first and the last
    chamber (front and rear), the phase of the last chamber, and the length and bending stiffness EI
    of the tail. Amplitude and phase change linearly from chamber to chamber. In a robot with one
    chamber, rear and phase have no influence. The command writes
    checkpoint.npz to DIR after every generation. The final files are optimum.json (history,
    settings, versions), optimum.png and best.toml, which is an experiment for `slider swim`.

    Args:
        out: folder for the results; created if missing.
        algorithm: optimiser: the genetic algorithm of the paper, gradient ascent from the best
            individuals of the first generation, or CMA-ES.
        frequency: bounds of the stride frequency, in Hz (default: 1 7).
        front: bounds of the first chamber's pressure amplitude, in Pa (default: 50e3 448e3).
        rear: bounds of the last chamber's pressure amplitude, in Pa (default: 50e3 448e3).
        phase: bounds of the last chamber's delay, as a fraction of a period (default: -0.5 0.5).
    """
    experiment = search.start()
    from slider_jax.io.files import output_folder
    from slider_jax.optimise import fastest_swimmer
    from slider_jax.optimise.optimiser import make_optimiser

    bounds = {"frequency": frequency, "front": front, "rear": rear, "phase": phase,
              "tail_length": search.tail_length, "EI_tail": search.EI_tail}  # fmt: skip
    task = fastest_swimmer.Task.of(experiment, bounds, search.steps_per_stride)
    population, generations = search.population, search.generations
    optimiser = make_optimiser(algorithm, population, 6)
    output_folder(out)
    report, write_in_one_process = _reporter(), _writer(out, "optimum.json")

    def on_generation(generation, seconds: float) -> None:
        text = f"best {1e2 * generation.best:.2f} cm/s, mean {1e2 * generation.mean:.2f}"
        report(generation, seconds, text, generations)

    with _resumable(out):
        found = fastest_swimmer.search_fastest(
            task, optimiser, population, generations, search.seed, out, search.resume, on_generation
        )

    def write() -> None:
        print("computing gradient and Hessian at the best design ...", file=sys.stderr)
        content = fastest_swimmer.write_optimum(task, found, out, search.inputs())
        print("\n".join(fastest_swimmer.optimum_summary(content)))
        print(f"wrote best.toml, optimum.json and optimum.png to {out}", file=sys.stderr)

    write_in_one_process(write)


def optimize_multimodal(
    search: SearchOptions = SearchOptions(),
    *,
    out: Folder,
    betas: Whole = 7,
    algorithm: Literal["genetic", "cma-es"] = "genetic",
) -> None:
    """Optimises one tail for swimming and climbing, with a drive for each task (paper's Fig. 9).

    The objective is eta(beta) = beta E_swim/E_swim,only + (1 - beta) E_climb/E_climb,only. E_swim
    is the Froude efficiency of swimming. E_climb is weight times speed divided by power, for
    climbing. The index "only" marks the largest efficiency. The command optimises each task alone,
    and then both tasks for each beta, starting from the best known design. DIR then contains
    multimodal.json, multimodal.png, and experiments for `slider swim` and `slider climb` for each
    beta. Each optimisation has a folder with a checkpoint.

    Args:
        out: folder for the results; created if missing.
        betas: number of evenly spaced values of beta from 0 (climbing alone) to 1 (swimming alone).
        algorithm: first optimiser of each task alone; all later optimisations use CMA-ES.
    """
    experiment = search.start()
    from slider_jax.io.files import output_folder
    from slider_jax.optimise.optimiser import make_optimiser
    from slider_jax.optimise.pareto_front import FrontEffort, search_front
    from slider_jax.optimise.report import front_summary, write_front
    from slider_jax.optimise.two_tasks import TwoTasks

    if not 2 <= betas <= 101:
        raise InputError.value("--betas", betas, "2 to 101 values, with beta = 0 and 1")
    make_optimiser(algorithm, search.population, 6)
    effort = FrontEffort(algorithm, search.population, search.generations, search.seed)
    modes = TwoTasks.of(experiment, search.tail_length, search.EI_tail, search.steps_per_stride)
    output_folder(out)
    report, write_in_one_process = _reporter(), _writer(out, "multimodal.json")

    def on_generation(name: str, generation, seconds: float) -> None:
        whole = search.generations if name.endswith("_only") else effort.between[1]
        score = f"E_{name.split('_')[0]}" if "only" in name else "eta"
        text = f"best {score} {generation.best:.4f}, mean {generation.mean:.4f}"
        report(generation, seconds, text, whole, name)

    with _resumable(out):
        found = search_front(modes, betas, effort, out, search.resume, on_generation)

    def write() -> None:
        print("simulating the best designs on the experiment's mesh ...", file=sys.stderr)
        content = write_front(modes, found, effort._asdict(), out, search.inputs())
        print("\n".join(front_summary(content)))
        print(f"wrote multimodal.json, multimodal.png and experiments to {out}", file=sys.stderr)

    write_in_one_process(write)


def optimize_transition(
    search: SearchOptions = SearchOptions(population=16, generations=40), *, out: Folder
) -> None:
    """Optimises the schedule of the gait and the tail on the way from the water to the wall.

    The robot swims with one gait and climbs with another gait and the same tail. The variables are
    frequency, set pressures and phase of both gaits, the time of the switch, the phase of the
    grips, and the length and stiffness of the tail. The command maximises the mean speed to the
    goal of the table [transition] by CMA-ES, after it has optimised swimming alone and climbing
    alone. DIR then contains optimum.json (designs, times, histories, settings), optimum.png and
    best.toml, which is an experiment for `slider transition`. Each part has a folder with a
    checkpoint.

    Args:
        out: folder for the results; created if missing.
    """
    experiment = search.start("slider_jax.transition.example:example_crosser")
    from slider_jax.io.files import output_folder
    from slider_jax.optimise import transition_search

    tail = {"tail_length": search.tail_length, "EI_tail": search.EI_tail}
    task = transition_search.CrossingTask.of(experiment, tail)
    effort = transition_search.CrossingEffort(search.population, search.generations, search.seed)
    output_folder(out)
    report, write_in_one_process = _reporter(), _writer(out, "optimum.json")

    def on_generation(part: str, generation, seconds: float) -> None:
        text = f"best {1e2 * generation.best:.2f} cm/s, mean {1e2 * generation.mean:.2f}"
        report(generation, seconds, text, effort.of(part), part)

    with _resumable(out):
        found = transition_search.search_crossing(task, effort, out, search.resume, on_generation)

    def write() -> None:
        print("simulating the best design on a refined mesh ...", file=sys.stderr)
        content = transition_search.write_crossing(task, found, effort, out, search.inputs())
        print("\n".join(transition_search.crossing_summary(content)))
        print(f"wrote best.toml, optimum.json and optimum.png to {out}", file=sys.stderr)

    write_in_one_process(write)
