"""From a command line's arguments to the call that they ask for, or to one error message."""

import inspect
from collections.abc import Callable, Sequence
from functools import partial, wraps
from typing import Any

import tyro

# The events behind tyro's error boxes. The module is private: tests/slider_jax/cli/test_parse.py
# fails if a new version of tyro changes what is used here.
from tyro import _errors as tyro_errors

from slider_jax.errors import InputError, did_you_mean


def call_of(command: Callable[..., Any], words: Sequence[str], name: str) -> Callable[[], Any]:
    """Returns `command` with the arguments in `words`, ready to be called.

    Raises `InputError` for invalid arguments, and `SystemExit` after `--help`.
    """
    _refuse_unknown_options(command, words)

    # tyro builds the call and does not run it, so that only parsing can reach the hook.
    @wraps(command)
    def call(*arguments: Any, **options: Any) -> Callable[[], Any]:
        return partial(command, *arguments, **options)

    def refuse(event: tyro_errors.ParseErrorEvent) -> None:
        raise InputError(f"{error_line(event)}; see slider {name} --help")

    style = tyro.conf.configure(tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff)
    with tyro_errors.on_parse_error(refuse):
        return tyro.cli(style(call), args=words, prog=f"slider {name}")


def _refuse_unknown_options(function: Callable[..., Any], words: Sequence[str]) -> None:
    """tyro reads the word after an unknown option as its value, and then reports a missing file."""
    allowed = ["--help"]
    for name, parameter in inspect.signature(function).parameters.items():
        notes = getattr(parameter.annotation, "__metadata__", ())
        if tyro.conf.Positional in notes:
            continue
        name = next((x.name for x in notes if getattr(x, "name", None)), name)
        allowed.append(f"--{'no-' if parameter.default is True else ''}{name.replace('_', '-')}")
    for word in words:
        option = word.split("=")[0].replace("_", "-")
        if option.startswith("--") and option not in allowed:
            advice = did_you_mean(option, allowed)
            raise InputError(
                f"{_printable(option)}: unknown option; allowed {', '.join(allowed)}{advice}"
            )


def error_line(event: tyro_errors.ParseErrorEvent) -> str:
    """Returns one line that says what is wrong with the arguments."""
    match event:
        case tyro_errors.MissingArgs():
            return f"{', '.join(_label(x.arg, True) for x in event.missing_arguments)}: missing"
        case tyro_errors.UnrecognizedArgs():
            return f"not understood: {' '.join(map(_printable, event.tokens))}"
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
    """Returns the argument as the help shows it: `FILE`, `--out`, or `--out DIR` with its value."""
    metavar = str(argument.lowered.metavar)
    if argument.is_positional():
        return metavar
    option = "/".join(argument.lowered.name_or_flags)
    return f"{option} {metavar}" if with_value else option


def _printable(word: str) -> str:
    return word if word.isprintable() else repr(word)
