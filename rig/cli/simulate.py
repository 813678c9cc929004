"""`slider rig simulate`: a rig that is not there."""

import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro

from rig.simulated.bench import MADE_UP
from rig.simulated.tank import TankState
from slider_jax.cli.options import MaybeExperiment, ModelFile, Value, Whole
from slider_jax.errors import InputError

if TYPE_CHECKING:
    from slider_jax.realtime.plant import Plant

SUPPLY_PRESSURE = 600e3
"""Gauge pressure of the simulated supply [Pa]."""
PLANT_STEP = 1e-3
"""Time step of the simulated robot [s]. With 2 ms, each pressure step causes a spike of 0.1 N in
the recoil."""
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
    inject: Annotated[tuple[str, ...], tyro.conf.arg(metavar="FAULT=VALUE@SECONDS")] = (),
    seed: Whole = 0,
    published: bool = False,
) -> None:
    """Start a manifold on a pseudo-terminal and a force sensor on the network, until Ctrl-C.

    No program can tell it from a rig. The port is printed, and a rig file that suits it written.
    With an experiment the chambers and sensors are those of the simulated robot in real time, with
    all of the file's effects; without, of a tail in air that only follows.

    Args:
        experiment: experiment file whose robot, water and effects are simulated.
        rig_file: file to write, for `slider rig run --rig`.
        model: TOML file whose [robot], [parameters] and [[effects]] override the experiment's.
        flipped: share of the bytes on the line of which a bit is flipped.
        dropped: share of the bytes on the line that are lost.
        noise: standard deviation of the pressures that are read [Pa].
        force_noise: standard deviation of the forces [N].
        tip_noise: standard deviation of the tip's place [m].
        inject: faults and when they begin, as leak_front_left=5@20: after 20 s, at 5 1/s.
        seed: of all chance.
        published: the authors' published firmware instead, with one chamber, for `slider rig log`.
    """
    from rig.scheduling import real_time_priority, share_priority_with_all_threads
    from rig.simulated.bench import serve_rig
    from rig.simulated.rig import LineFaults, SimulatedRig
    from slider_jax.io.files import write_text

    for name, share in (("--flipped", flipped), ("--dropped", dropped)):
        if not 0.0 <= share <= 0.5:
            raise InputError.value(name, f"{share:g}", "0 to 0.5, a share of the bytes")
    for name, deviation in (
        ("--noise", noise), ("--force-noise", force_noise), ("--tip-noise", tip_noise),
    ):  # fmt: skip
        if not 0.0 <= deviation < np.inf:
            raise InputError.value(name, f"{deviation:g}", "0 or more")
    if published:
        given = {
            "an experiment": experiment, "--model": model, "--inject": inject, "--flipped": flipped,
            "--dropped": dropped, "--force-noise": force_noise != FORCE_NOISE,
            "--tip-noise": tip_noise != TIP_NOISE, "--rig-file": rig_file != RIG_FILE,
        }  # fmt: skip
        if any(given.values()):
            found = ", ".join(name for name, x in given.items() if x)
            raise InputError.value("--published", f"with {found}", "--noise and --seed beside it")
        _serve_published(noise, seed)
        return
    _refuse_other(rig_file)
    faults = sorted((_fault(text) for text in inject), key=lambda fault: fault[2])
    tank, put = _tank(experiment, model, [name for name, _, _ in faults])

    def at(seconds: float) -> None:
        while faults and seconds >= faults[0][2]:
            name, value, _ = faults.pop(0)
            put(name, value)
            print(f"{seconds:.1f} s: {name} is {value:g}", file=sys.stderr, flush=True)

    # Manifold and force sensor are threads: by default one may keep the other waiting for 5 ms.
    sys.setswitchinterval(2e-4)
    line_faults = LineFaults(
        flipped=flipped, dropped=dropped, noise=noise, tip_noise=tip_noise, seed=seed
    )
    simulated = SimulatedRig(tank, faults=line_faults)
    with real_time_priority(), serve_rig(simulated, force_noise, at, seed) as rig:
        share_priority_with_all_threads()
        if rig_file.exists():
            print(f"{rig_file} is replaced: it was of another simulated rig", file=sys.stderr)
        write_text(rig_file, rig.settings())
        print(f"port {rig.port}", flush=True)
        print(
            f"its rig file is {rig_file}; from another terminal, for example:\n"
            f"  slider rig check --port {rig.port} --rig {rig_file}\n"
            f"  slider rig run {experiment or 'docs/experiment.toml'} --port {rig.port} "
            f"--rig {rig_file} --out measured\n"
            "Ctrl-C ends it",
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
        f"from another terminal, for example:\n"
        f"  slider rig log 1 2 --port {terminal.path} --out logs\n"
        "Ctrl-C ends it",
        file=sys.stderr,
        flush=True,
    )
    with real_time_priority():
        terminal.serve(lambda: False)


def _refuse_other(rig_file: Path) -> None:
    """A rig file that somebody wrote is not written over."""
    if rig_file.is_dir() or (
        rig_file.exists() and MADE_UP not in rig_file.read_text(errors="replace")
    ):
        raise InputError(
            f"--rig-file {rig_file}: is there, and not one of a simulated rig; give another name"
        )


class RobotTank:
    """A `rig.simulated.tank.Tank` of an experiment's robot, water and effects."""

    def __init__(self, plant: "Plant"):
        self._plant = plant

    def advance(self, set_pressures: tuple[int, ...] | None, seconds: float) -> TankState:
        """As `Tank.advance`."""
        found = self._plant.advance(set_pressures or [None] * 4, seconds)
        a, b, c, d = (float(p) for p in found.pressures)
        return TankState((a, b, c, d), SUPPLY_PRESSURE, found.thrust_N, found.recoil_N, found.tip_m)


def _fault(text: str) -> tuple[str, float, float]:
    try:
        name, rest = text.split("=")
        value, when = (float(x) for x in rest.split("@"))
        if not (0.0 <= value < np.inf and 0.0 <= when < np.inf):
            raise ValueError
        return name, value, when
    except ValueError:
        raise InputError.value(
            "--inject", repr(text), "FAULT=VALUE@SECONDS, 0 or more each, as leak_front_left=5@20"
        ) from None


def _tank(experiment: Path | None, model: Path | None, faults: list[str]):
    """What is controlled and measured, and what puts a fault into it. `faults` are to come."""
    from rig.protocol.messages import CHAMBERS
    from rig.simulated.tank import BenchTank

    if experiment is not None:
        if hasattr(os, "sched_setaffinity"):
            # XLA hands so small a step to its threads, which takes twice the time.
            os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
        from slider_jax.cli.main import prepare_jax
        from slider_jax.experiment.load import load
        from slider_jax.realtime.faults import with_fault
        from slider_jax.realtime.plant import Plant

        prepare_jax()
        loaded = load(experiment, model)
        moving = [t.file for t in loaded.trials if t.tow_speed or t.clamp_moves]
        if moving:
            print(
                f"its clamp stands still: {', '.join(moving)} will not be measured as that says",
                file=sys.stderr,
            )
        print("compiling the simulated robot ...", file=sys.stderr, flush=True)
        plant = Plant(loaded, step=PLANT_STEP)
        for name in faults:
            with_fault(plant.faults, name, 0.1)
        return RobotTank(plant), plant.inject
    if model is not None:
        raise InputError(f"--model {model}: given without an experiment; give both")
    bench = BenchTank()
    allowed = {f"leak_{chamber}": i for i, chamber in enumerate(CHAMBERS)}
    for name in faults:
        if name not in allowed:
            raise InputError.value(
                "--inject", name, ", ".join(allowed), "the others need an experiment file"
            )

    def leak(name: str, value: float) -> None:
        bench.leak[allowed[name]] = value

    return bench, leak
