"""The `slider` command: finds the subcommand, prepares JAX, and turns errors into messages."""

import os
import sys
from collections.abc import Sequence
from pathlib import Path

from slider_jax.cli.commands import COMMANDS, function_of, rig_error
from slider_jax.errors import InputError, SolverError, did_you_mean

_GROUPS = {name.split()[0] for name in COMMANDS if " " in name} - {
    name for name, command in COMMANDS.items() if command.alone
}


def usage(group: str = "") -> str:
    """Returns the list of all subcommands, or of the subcommands of a `group` like "calibrate"."""
    shown = {name: x for name, x in COMMANDS.items() if name.startswith(group)}
    width = max(map(len, shown))
    lines = [f"  {name:<{width}}  {command.help}" for name, command in shown.items()]
    head = f"usage: slider {group or 'COMMAND'}{' COMMAND' if group else ''} [--help] ..."
    return "\n".join([head, "", "commands:", *lines])


def prepare_jax() -> None:
    """Enables float64, and keeps compiled programs in the user's cache folder between runs.

    `JAX_COMPILATION_CACHE_DIR` sets another folder. `SLIDER_CACHE=off` disables the cache. Large
    arrays return their memory when they are freed.
    """
    # During long compilations XLA logs a warning that looks like an error. Real errors are raised.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    # Commands give each core a thread of their own. Further threads of BLAS would only compete.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from slider_jax.precision import enable_float64
    from slider_jax.programs import return_large_arrays

    enable_float64()
    return_large_arrays()
    if os.environ.get("SLIDER_CACHE") == "off":
        return
    import jax

    from slider_jax.io.files import cache_folder

    folder = os.environ.get("JAX_COMPILATION_CACHE_DIR") or str(cache_folder())
    jax.config.update("jax_compilation_cache_dir", folder)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


def find(arguments: Sequence[str]) -> tuple[str, list[str]]:
    """Returns the subcommand at the start of `arguments`, and the remaining arguments."""
    words = list(arguments)
    for name in COMMANDS:
        parts = name.split()
        rest = words[len(parts) :]
        # After `slider calibrate`, a word of letters that is not a file is a mistyped subcommand.
        mistyped = name in _GROUPS and rest and rest[0].isalpha() and not Path(rest[0]).exists()
        if words[: len(parts)] == parts and not mistyped:
            return name, rest
    group = words[0] in _GROUPS
    given = " ".join(words[: 2 if group else 1])
    allowed = [name for name in COMMANDS if not group or name.split()[0] == words[0]]
    raise InputError(
        f"command: given {given!r}; allowed {', '.join(allowed)}"
        f"{did_you_mean(given, allowed)}; see slider --help"
    )


def run_command(arguments: Sequence[str]) -> int:
    """Runs one command and returns its exit code. Raises input and solver errors."""
    from slider_jax.cli.parse import call_of

    name, rest = find(arguments)
    if not COMMANDS[name].jax:
        return int(call_of(function_of(COMMANDS[name].target), rest, name)() or 0)
    prepare_jax()
    call = call_of(function_of(COMMANDS[name].target), rest, name)
    from slider_jax.programs import kept_programs

    with kept_programs():
        return int(call() or 0)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs `slider` and returns its exit code.

    The code is 0 after success, 2 for invalid input or a failed solution, 130 if interrupted. If
    the reader of the output ends early, as in `slider effects | head`, the code is 141, as for a
    program that the signal SIGPIPE ends.
    """
    try:
        code = _run(sys.argv[1:] if arguments is None else arguments)
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    return code


def _run(arguments: Sequence[str]) -> int:
    """Runs `slider` and returns its exit code, or raises `BrokenPipeError`."""
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
        return run_command(arguments)
    except (InputError, SolverError, KeyboardInterrupt, rig_error()) as error:
        stopped = isinstance(error, KeyboardInterrupt)
        text = "interrupted" if stopped else f"error: {error}"
        # The exception's notes describe errors that occurred while the command was stopping. JAX
        # adds a note on its traceback, which is not printed.
        notes = [x for x in getattr(error, "__notes__", ()) if "JAX_TRACEBACK_FILTERING" not in x]
        print("\n".join([f"slider: {text}", *notes]), file=sys.stderr)
        return 130 if stopped else 2


if __name__ == "__main__":
    sys.exit(main())
