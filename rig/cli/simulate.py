"""`slider rig simulate`: simulates a rig, to try the commands without hardware."""

import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro

from rig.simulated.bench import MADE_UP
from rig.simulated.tank import TankState
from slider_jax.cli.options import EffectFiles, MaybeExperiment, ModelFile, Value, Whole
from slider_jax.errors import InputError

if TYPE_CHECKING:
    from slider_jax.realtime.plant import Plant

SUPPLY_PRESSURE = 600e3
"""Gauge pressure of the simulated supply [Pa]."""
PLANT_STEP = 1e-3
"""Time step of the simulated robot [s]. With 2 ms, each sudden change of a set pressure causes a
spike of 0.1 N in the recoil."""
RIG_FILE, FORCE_NOISE, TIP_NOISE = Path("simulated_rig.toml"), 2e-3, 2e-5


def rig_simulate(
    experiment: MaybeExperiment = None,
    rig_file: Annotated[Path, tyro.conf.arg(metavar="RIG.toml")] = RIG_FILE,
    model: ModelFile = None,
    flipped: Value = 0.0,
    dropped: Value = 0.0,
    noise: Value = 200.0,
    force_noise: Value = FORCE_NOISE,
    tip_noise: Value = TIP_NOISE,
    inject: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="FAULT=VALUE@SECONDS", help_behavior_hint="")
    ] = (),
    seed: Whole = 0,
    published: bool = False,
    effects: EffectFiles = (),
) -> None:
    """Simulates a manifold on a pseudo-terminal and a force sensor on the network until Ctrl-C.

    The devices use the same protocols as real devices. The command prints the port and writes a
    matching rig file. With an experiment file, the command simulates the robot in water with all
    effects of the file, in real time. Without an experiment file, the robot is a tail in air.

    Args:
        experiment: experiment file whose robot, water and effects are simulated (default: a tail
            in air).
        rig_file: file to which the command writes the rig file, for `slider rig run --rig`.
        model: TOML file. Its keys of [robot] and [parameters] replace the experiment's keys, and
            its [[effects]] are added.
        flipped: fraction of the bytes on the serial line with a flipped bit, 0 to 0.5.
        dropped: fraction of the bytes on the serial line that are lost, 0 to 0.5.
        noise: standard deviation of the measured pressures, in Pa.
        force_noise: standard deviation of the measured forces, in N.
        tip_noise: standard deviation of the measured tip position, in m.
        inject: faults, each with a value and a start time in s. For example, leak_front_left=5@20
            is a leak of 5 1/s that starts at 20 s (default: none).
        seed: seed of the random numbers.
        published: simulate the authors' published firmware with one chamber, for `slider rig log`.
    """
    from rig.scheduling import real_time_priority, share_priority_with_all_threads
    from rig.simulated.bench import serve_rig
    from rig.simulated.manifold import HARD_LIMIT, ManifoldCore
    from rig.simulated.rig import LineFaults, SimulatedRig
    from slider_jax.io.files import write_text

    for name, share in (("--flipped", flipped), ("--dropped", dropped)):
        if not 0.0 <= share <= 0.5:
            raise InputError.value(name, f"{share:g}", "0 to 0.5, a fraction of the bytes")
    for name, deviation in (
        ("--noise", noise), ("--force-noise", force_noise), ("--tip-noise", tip_noise),
    ):  # fmt: skip
        if not 0.0 <= deviation < np.inf:
            raise InputError.value(name, f"{deviation:g}", "0 or more")
    if published:
        given = {
            "an experiment": experiment, "--model": model, "--effects": effects, "--inject": inject,
            "--flipped": flipped, "--dropped": dropped, "--force-noise": force_noise != FORCE_NOISE,
            "--tip-noise": tip_noise != TIP_NOISE, "--rig-file": rig_file != RIG_FILE,
        }  # fmt: skip
        if any(given.values()):
            found = ", ".join(name for name, x in given.items() if x)
            raise InputError.value("--published", f"with {found}", "--noise and --seed only")
        _serve_published(noise, seed)
        return
    _refuse_other(rig_file)
    faults = sorted((_fault(text) for text in inject), key=lambda fault: fault[2])
    tank, inject_fault, chambers = _tank(
        experiment, model, effects, [name for name, _, _ in faults]
    )

    def at(seconds: float) -> None:
        while faults and seconds >= faults[0][2]:
            name, value, _ = faults.pop(0)
            inject_fault(name, value)
            print(f"{seconds:.1f} s: {name} is {value:g}", file=sys.stderr, flush=True)

    # With Python's default switch interval of 5 ms, the threads of the manifold and of the force
    # sensor may delay one another by 5 ms.
    sys.setswitchinterval(2e-4)
    line_faults = LineFaults(
        flipped=flipped, dropped=dropped, noise=noise, tip_noise=tip_noise, seed=seed
    )
    simulated = SimulatedRig(
        tank, faults=line_faults, new_core=lambda: ManifoldCore((HARD_LIMIT,) * chambers)
    )
    with real_time_priority(), serve_rig(simulated, force_noise, at, seed) as rig:
        share_priority_with_all_threads()
        if rig_file.exists():
            print(f"{rig_file} of an earlier simulated rig is replaced", file=sys.stderr)
        write_text(rig_file, rig.settings())
        print(f"port {rig.port}", flush=True)
        print(
            f"the rig file is {rig_file}; in another terminal, run for example:\n"
            f"  slider rig check {f'{experiment} ' if experiment else ''}--port {rig.port} "
            f"--rig {rig_file}\n"
            f"  slider rig run {experiment or 'docs/experiment.toml'} --port {rig.port} "
            f"--rig {rig_file} --out measured\n"
            "press Ctrl-C to stop the simulated rig",
            file=sys.stderr,
            flush=True,
        )
        while True:
            time.sleep(0.2)


def _serve_published(noise: float, seed: int) -> None:
    from rig.scheduling import real_time_priority
    from rig.simulated.published import PublishedFirmware, simulate_frequency_test
    from rig.simulated.tank import BenchChamber
    from rig.simulated.terminal import Terminal

    terminal = Terminal(
        PublishedFirmware(simulate_frequency_test(BenchChamber(noise=noise, seed=seed)))
    )
    print(f"port {terminal.path}", flush=True)
    print(
        "in another terminal, run for example:\n"
        f"  slider rig log 1 2 --port {terminal.path} --out logs\n"
        "press Ctrl-C to stop the simulated manifold",
        file=sys.stderr,
        flush=True,
    )
    with real_time_priority():
        terminal.serve(lambda: False)


def _refuse_other(rig_file: Path) -> None:
    """Raises `InputError` if the file exists and was not written by `slider rig simulate`."""
    if rig_file.is_dir() or (
        rig_file.exists() and MADE_UP not in rig_file.read_text(errors="replace")
    ):
        raise InputError(
            f"--rig-file {rig_file}: exists, and was not written by `slider rig simulate`; give "
            "another name"
        )


class RobotTank:
    """A `rig.simulated.tank.Tank` that simulates an experiment's robot, water and effects."""

    def __init__(self, plant: "Plant"):
        self._plant = plant

    def advance(self, set_pressures: tuple[int, ...] | None, seconds: float) -> TankState:
        """Implements `Tank.advance`."""
        vented = [None] * len(self._plant.chambers)
        found = self._plant.advance(set_pressures or vented, seconds)
        forces = found.thrust_N, found.recoil_N
        return TankState(found.pressures, SUPPLY_PRESSURE, *forces, found.tip_m)


def _fault(text: str) -> tuple[str, float, float]:
    try:
        name, rest = text.split("=")
        value, when = (float(x) for x in rest.split("@"))
        if not (0.0 <= value < np.inf and 0.0 <= when < np.inf):
            raise ValueError
        return name, value, when
    except ValueError:
        raise InputError.value(
            "--inject",
            repr(text),
            "FAULT=VALUE@SECONDS with numbers from 0, such as leak_front_left=5@20",
        ) from None


def _tank(
    experiment: Path | None, model: Path | None, effects: tuple[Path, ...], faults: list[str]
):
    """Returns the simulated tank, its function `inject(name, value)` for the named `faults`, and
    the number of its chambers."""
    from rig.chambers import SLIDER
    from rig.cli.shared import layout_of
    from rig.simulated.tank import BenchTank

    if experiment is not None:
        if hasattr(os, "sched_setaffinity"):
            # The simulation uses one core: several threads of XLA double the time of a small step.
            os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
        from slider_jax.cli.main import prepare_jax
        from slider_jax.effects.library import load_all_effects
        from slider_jax.experiment.load import load
        from slider_jax.realtime.faults import with_fault
        from slider_jax.realtime.plant import Plant

        prepare_jax()
        load_all_effects(effects)
        loaded = load(experiment, model)
        layout_of(loaded, experiment)  # refuses a robot that the protocol cannot drive
        moving = [t.file for t in loaded.trials if t.tow_speed or t.clamp_moves]
        if moving:
            print(
                f"these trials move the clamp, but the simulated one is fixed: {', '.join(moving)}",
                file=sys.stderr,
            )
        print("compiling the simulated robot ...", file=sys.stderr, flush=True)
        plant = Plant(loaded, step=PLANT_STEP)
        for name in faults:
            with_fault(plant.faults, plant.chambers, name, 0.1)
        return RobotTank(plant), plant.inject, len(plant.chambers)
    if model is not None:
        raise InputError(f"--model {model}: needs an experiment file; give a file, or omit --model")
    if effects:
        raise InputError(
            f"--effects {effects[0]}: needs an experiment file; give a file, or omit --effects"
        )
    bench = BenchTank()
    allowed = {f"leak_{chamber}": i for i, chamber in enumerate(SLIDER.names)}
    for name in faults:
        if name not in allowed:
            raise InputError.value(
                "--inject", name, ", ".join(allowed), "other faults need an experiment file"
            )

    def leak(name: str, value: float) -> None:
        bench.leak[allowed[name]] = value

    return bench, leak, len(bench.leak)
