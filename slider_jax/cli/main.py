"""The `slider` command: finds the subcommand, prepares JAX, and turns errors into messages."""

import os
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from rig.errors import RigError
from slider_jax.errors import InputError, SolverError, nearest


class Command(NamedTuple):
    """A subcommand: `module:function`, imported only when it is asked for, and a line of help.

    The function's signature is the command line, by tyro; it returns None or an exit code.
    """

    target: str
    help: str
    alone: bool = False
    """Of a group's own command: whether it runs without arguments, and takes bare words."""
    jax: bool = True
    """Whether it needs JAX, which the computer beside a tank may lack."""


COMMANDS = {
    "simulate": Command(
        "slider_jax.cli.simulate:simulate", "an experiment, or a pressure log, to thrust"
    ),
    "demo": Command("slider_jax.cli.demo:demo", "the paper's frequency sweep, no input needed"),
    "sweep": Command(
        "slider_jax.cli.sweep:sweep", "one or two fields of an experiment over ranges"
    ),
    "swim": Command("slider_jax.cli.swim:swim", "the robot set free, and its steady speed"),
    "climb": Command("slider_jax.cli.climb:climb", "the robot pinned to a wall, in air"),
    "optimize swim": Command(
        "slider_jax.cli.optimize:swim", "tail and gait for the fastest swimming"
    ),
    "optimize multimodal": Command(
        "slider_jax.cli.optimize:multimodal", "one tail to swim and to climb with"
    ),
    "close-loop": Command(
        "calibration.cli.close_loop:close_loop", "what a model lacks, from measured trials"
    ),
    "lamprey": Command(
        "calibration.cli.lamprey:lamprey", "a swimming animal's midlines, weighed by the model"
    ),
    "published": Command(
        "calibration.cli.published:published", "the paper's swimming speeds against its equations"
    ),
    "effects matrix": Command(
        "calibration.cli.effects_matrix:matrix",
        "which of them an experiment could find and separate",
    ),
    "effects": Command(
        "slider_jax.cli.effects:effects",
        "what a model may lack, and what it does to the sensors",
        alone=True,
    ),
    "calibrate manifold": Command(
        "calibration.cli.calibrate:manifold", "the pressure lag from the rig's own logs"
    ),
    "calibrate statics": Command(
        "calibration.cli.calibrate_statics:statics", "EI, damping and K_Q from a bench, in air"
    ),
    "calibrate": Command(
        "calibration.cli.calibrate_tank:tank", "C_d, m_a, k and K_Q from measured trials"
    ),
    "rig ports": Command("rig.cli.shared:ports", "this computer's serial ports", jax=False),
    "rig check": Command(
        "rig.cli.check:check", "line, noise and leaks of a rig, in a minute", jax=False
    ),
    "rig run": Command("rig.cli.run:run", "an experiment's trials on the rig, recorded", jax=False),
    "rig log": Command("rig.cli.log:log", "pressure logs of the published firmware", jax=False),
    "rig replay": Command(
        "rig.cli.replay:replay",
        "a recording's columns anew, or at its own pace",
        jax=False,
    ),
    "rig watch": Command(
        "rig.cli.watch:watch", "the calibrated model beside a running rig, with alarm"
    ),
    "rig loop": Command("rig.cli.loop:loop", "measure and close the loop until it is settled"),
    "rig simulate": Command(
        "rig.cli.simulate:simulate",
        "a rig that is not there, to try all this on",
        jax=False,
    ),
}

_GROUPS = {name.split()[0] for name in COMMANDS if " " in name} - {
    name for name, command in COMMANDS.items() if command.alone
}


def usage(group: str = "") -> str:
    """The list of subcommands, or of those of a `group` such as "calibrate"."""
    shown = {name: x for name, x in COMMANDS.items() if name.startswith(group)}
    width = max(map(len, shown))
    lines = [f"  {name:<{width}}  {command.help}" for name, command in shown.items()]
    head = f"usage: slider {group or 'COMMAND'}{' COMMAND' if group else ''} [--help] ..."
    return "\n".join([head, "", "commands:", *lines])


def prepare_jax() -> None:
    """float64, and compiled programs kept between runs under the user's cache folder.

    `JAX_COMPILATION_CACHE_DIR` chooses another folder; `SLIDER_CACHE=off` keeps none.
    """
    # No log of XLA's: its alarm at a long compilation reads as a fault. Errors are raised.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    from slider_jax.precision import enable_float64

    enable_float64()
    if os.environ.get("SLIDER_CACHE") == "off":
        return
    import jax

    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = os.environ.get("JAX_COMPILATION_CACHE_DIR") or str(home / "slider_jax")
    jax.config.update("jax_compilation_cache_dir", folder)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


def find(arguments: Sequence[str]) -> tuple[str, list[str]]:
    """The subcommand that `arguments` begin with, and what is left of them."""
    words = list(arguments)
    for name in COMMANDS:
        parts = name.split()
        rest = words[len(parts) :]
        # A bare word after a group's own command is a mistyped command of it, not a file.
        mistyped = name in _GROUPS and rest and rest[0].isalpha() and not Path(rest[0]).exists()
        if words[: len(parts)] == parts and not mistyped:
            return name, rest
    group = words[0] in _GROUPS
    given = " ".join(words[: 2 if group else 1])
    allowed = [name for name in COMMANDS if not group or name.split()[0] == words[0]]
    raise InputError(
        f"command: given {given!r}; allowed {', '.join(allowed)}"
        f"{nearest(given, allowed)}; see slider --help"
    )


def run(arguments: Sequence[str]) -> int:
    """Run one command and return its exit code; input and solver errors are raised."""
    name, rest = find(arguments)
    if COMMANDS[name].jax:
        prepare_jax()
    module, function = COMMANDS[name].target.split(":")
    from slider_jax.cli.parse import call_of

    return int(call_of(getattr(import_module(module), function), rest, name)() or 0)


def _notes(error: BaseException) -> list[str]:
    """What else went wrong on the way out."""
    return list(getattr(error, "__notes__", ()))


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point: exit code 0, 2 for a bad input or a failed solve, 130 when interrupted."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        print(usage())
        return 0
    if arguments[0] in _GROUPS and (len(arguments) == 1 or arguments[1] in ("-h", "--help")):
        print(usage(arguments[0]))
        if len(arguments) == 1 or arguments[0] not in COMMANDS:
            return 0
        print()
    if arguments[0] == "--version":
        from slider_jax import __version__

        print(f"slider {__version__}")
        return 0
    try:
        return run(arguments)
    except (InputError, SolverError, RigError) as error:
        print("\n".join([f"slider: error: {error}", *_notes(error)]), file=sys.stderr)
        return 2
    except KeyboardInterrupt as interrupt:
        print("\n".join(["slider: interrupted", *_notes(interrupt)]), file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
