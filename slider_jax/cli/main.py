"""The `slider` command: finds the subcommand, prepares JAX, and turns errors into messages."""

import os
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from slider_jax.errors import InputError, SolverError


class Command(NamedTuple):
    """A subcommand: `module:function`, imported only when it is asked for, and a line of help.

    The function's signature is the command line, by tyro; it returns None or an exit code.
    """

    target: str
    help: str


COMMANDS = {
    "simulate": Command(
        "slider_jax.cli.simulate:simulate", "an experiment, or a pressure log, to thrust"
    ),
    "demo": Command("slider_jax.cli.demo:demo", "the paper's frequency sweep, no input needed"),
    "sweep": Command(
        "slider_jax.cli.sweep:sweep", "one or two fields of an experiment over ranges"
    ),
    "calibrate manifold": Command(
        "slider_jax.cli.calibrate:manifold", "the pressure lag from the rig's own logs"
    ),
}


def usage() -> str:
    """The list of subcommands."""
    width = max(map(len, COMMANDS))
    lines = [f"  {name:<{width}}  {command.help}" for name, command in COMMANDS.items()]
    return "\n".join(["usage: slider COMMAND [--help] ...", "", "commands:", *lines])


def prepare_jax() -> None:
    """float64, and compiled programs kept between runs under the user's cache folder.

    `JAX_COMPILATION_CACHE_DIR` chooses another folder; `SLIDER_CACHE=off` keeps none.
    """
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
        if words[: len(parts)] == parts:
            return name, words[len(parts) :]
    given = " ".join(words[:2]) or "nothing"
    raise InputError(f"command: given {given!r}; allowed {', '.join(COMMANDS)}; see slider --help")


def run(arguments: Sequence[str]) -> int:
    """Run one command and return its exit code; input and solver errors are raised."""
    name, rest = find(arguments)
    module, function = COMMANDS[name].target.split(":")
    import tyro

    parsed = tyro.cli(
        tyro.conf.configure(tyro.conf.OmitArgPrefixes)(getattr(import_module(module), function)),
        args=rest,
        prog=f"slider {name}",
    )
    return int(parsed or 0)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point: exit code 0, 2 for a bad input or a failed solve, 130 when interrupted."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        print(usage())
        return 0
    if arguments[0] == "--version":
        from slider_jax import __version__

        print(f"slider {__version__}")
        return 0
    try:
        prepare_jax()
        return run(arguments)
    except (InputError, SolverError) as error:
        print(f"slider: error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("slider: interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
