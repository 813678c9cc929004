"""A command's words to the call that they ask for; bad ones to one message."""

import inspect
import io
import os
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr
from functools import partial, wraps
from typing import Any

import tyro

from slider_jax.errors import InputError, did_you_mean


def call_of(command: Callable[..., Any], words: Sequence[str], name: str) -> Callable[[], Any]:
    """`command` with the arguments that `words` give it.

    Raises `InputError` for words that cannot be used, and `SystemExit` after `--help`.
    """
    _refuse_unknown_options(command, words)

    # Built, not run: what the command itself says on stderr is not held back.
    @wraps(command)
    def call(*arguments: Any, **options: Any) -> Callable[[], Any]:
        return partial(command, *arguments, **options)

    style = tyro.conf.configure(tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff)
    said = io.StringIO()
    try:
        with _unwrapped(words), redirect_stderr(said):
            return tyro.cli(style(call), args=words, prog=f"slider {name}")
    except SystemExit as end:
        if end.code == 2:
            raise InputError(f"{in_one_line(said.getvalue())}; see slider {name} --help") from None
        raise


@contextmanager
def _unwrapped(words: Sequence[str]) -> Iterator[None]:
    """A line of tyro's is as long as it needs, lest what was given is broken; help is laid out."""
    before = os.environ.get("COLUMNS")
    if not {"-h", "--help"} & set(words):
        os.environ["COLUMNS"] = "99999"
    try:
        yield
    finally:
        if before is not None:
            os.environ["COLUMNS"] = before
        elif "COLUMNS" in os.environ:
            del os.environ["COLUMNS"]


def _refuse_unknown_options(function: Callable[..., Any], words: Sequence[str]) -> None:
    """tyro takes what follows an unknown option for its value, and then misses a file."""
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
            shown = option if option.isprintable() else repr(option)
            advice = did_you_mean(option, allowed)
            raise InputError(f"{shown}: unknown option; allowed {', '.join(allowed)}{advice}")


def in_one_line(box: str) -> str:
    """What is in a box of tyro's: its sentence, or the names of what is missing.

    With UTF-8 a box is framed, otherwise ruled:

        ╭─ Value error ─────────────╮         Value error
        │ Error parsing --step: ... │         -------------------------
        │ ───────────────────────── │          Error parsing --step: ...
        │ For full helptext, ...    │         -------------------------
        ╰───────────────────────────╯          For full helptext, ...
    """
    plain = re.sub(r"\x1b\[[0-9;]*m", "", box)
    rows = [row.strip("│╭╮╰╯").rstrip() for row in plain.splitlines()]
    rules = [i for i, row in enumerate(rows) if re.fullmatch(r" *[─-]{2,}", row)]
    framed = plain.startswith("╭")
    begin, end = (1, 0) if framed else (2, 1)  # title, and its rule; which rule ends it
    if len(rules) <= end or not rows[begin : rules[end]]:
        return plain.strip()
    rows = rows[begin : rules[end]]
    if rows[0].strip().startswith("Missing from"):
        depth = len(rows[0]) - len(rows[0].lstrip()) + 4
        names = [row.strip() for row in rows if re.match(rf" {{{depth}}}\S", row)]
        return f"{', '.join(names)}: missing"
    sentence = " ".join(row.strip() for row in rows).removesuffix(" Expected 1 values.")
    sentence = sentence.replace("Unrecognized options:", "not understood:")
    return sentence.removeprefix("Error parsing ").rstrip(".")
