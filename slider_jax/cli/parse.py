"""Converts a command line's arguments to a function call, or to an error message of one line."""

import inspect
import re
from collections.abc import Callable, Sequence
from dataclasses import is_dataclass
from functools import partial, wraps
from pathlib import Path
from typing import Any

import tyro

# tyro reports errors in the arguments by events, which this private module of tyro defines.
# tests/slider_jax/cli/test_parse.py fails if a new tyro version changes these events.
from tyro import _errors as tyro_errors

from slider_jax.cli.commands import COMMANDS
from slider_jax.cli.options import EffectFiles
from slider_jax.errors import InputError, did_you_mean

_EFFECTS = inspect.Parameter(
    "effects", inspect.Parameter.KEYWORD_ONLY, default=(), annotation=EffectFiles
)


def call_of(command: Callable[..., Any], words: Sequence[str], name: str) -> Callable[[], Any]:
    """Returns a function that calls `command` with the arguments in `words`.

    If `COMMANDS` says so for the command `name`, the words may contain the option --effects. The
    returned function then loads the effects of installed packages and of the files first. Raises
    `InputError` for invalid arguments, and `SystemExit` after `--help`.
    """
    signature, loads = inspect.signature(command), COMMANDS[name].effects
    if loads:
        signature = signature.replace(parameters=[*signature.parameters.values(), _EFFECTS])
    _refuse_unknown_options(signature, words)

    # tyro runs `call`, which does not run the command. Only parsing errors thus reach `refuse`.
    @wraps(command)
    def call(*arguments: Any, **options: Any) -> Callable[[], Any]:
        files = options.pop(_EFFECTS.name) if loads else ()
        run = partial(command, *arguments, **options)
        return partial(_with_effects, files, run) if loads else run

    # tyro prints the line breaks of a help text. This substitution joins the lines of each text.
    call.__doc__ = re.sub(r"\n {8,}", " ", inspect.getdoc(command) or "")
    vars(call)["__signature__"] = signature
    call.__annotations__ = {k: x.annotation for k, x in signature.parameters.items()}
    del vars(call)["__wrapped__"]  # else tyro reads the original docstring

    def refuse(event: tyro_errors.ParseErrorEvent) -> None:
        raise InputError(f"{error_line(event)}; see slider {name} --help")

    style = tyro.conf.configure(tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff)
    with tyro_errors.on_parse_error(refuse):
        return tyro.cli(style(call), args=words, prog=f"slider {name}")


def _with_effects(files: Sequence[Path], run: Callable[[], Any]) -> Any:
    """Loads the effects of installed packages and of `files`, then runs a command."""
    from slider_jax.effects.library import load_all_effects

    load_all_effects(files)
    return run()


def _refuse_unknown_options(signature: inspect.Signature, words: Sequence[str]) -> None:
    """Raises `InputError` for an unknown option.

    Without this check, tyro takes the next word as the option's value and reports a missing file.
    """
    allowed, parameters = ["--help"], list[inspect.Parameter]()
    for x in signature.parameters.values():
        is_group = is_dataclass(x.annotation)
        parameters += inspect.signature(x.annotation).parameters.values() if is_group else [x]
    for parameter in parameters:
        notes = getattr(parameter.annotation, "__metadata__", ())
        if tyro.conf.Positional in notes:
            continue
        name = next((x.name for x in notes if getattr(x, "name", None)), parameter.name)
        allowed.append(f"--{'no-' if parameter.default is True else ''}{name.replace('_', '-')}")
    for word in words:
        option = word.split("=")[0].replace("_", "-")
        if option.startswith("--") and option not in allowed:
            advice = did_you_mean(option, allowed)
            raise InputError(
                f"{_printable(option)}: unknown option; allowed {', '.join(allowed)}{advice}"
            )


def error_line(event: tyro_errors.ParseErrorEvent) -> str:
    """Returns one line that describes the error in the arguments."""
    match event:
        case tyro_errors.MissingArgs():
            return f"{', '.join(_label(x.arg, True) for x in event.missing_arguments)}: missing"
        case tyro_errors.UnrecognizedArgs():
            return f"unexpected arguments: {' '.join(map(_printable, event.tokens))}"
        case tyro_errors.InvalidChoice():
            allowed = ", ".join(event.choices)
            return f"{_label(event.argument)}: given {event.value!r}; allowed {allowed}"
        case tyro_errors.BadValue():
            return f"{_label(event.argument)}: value missing"
        case tyro_errors.InstantiationFailure():
            text = " ".join(event.message.split("\n"))
            text = text.removesuffix(" Expected 1 values.").rstrip(".")
            return f"{_label(event.argument)}: {text}" if event.argument else text
    return "invalid arguments"


def _label(argument: Any, with_value: bool = False) -> str:
    """Returns the argument as in the help: `FILE`, `--out`, or `--out DIR` if `with_value`."""
    metavar = str(argument.lowered.metavar)
    if argument.is_positional():
        return metavar
    option = "/".join(argument.lowered.name_or_flags)
    return f"{option} {metavar}" if with_value else option


def _printable(word: str) -> str:
    return word if word.isprintable() else repr(word)
