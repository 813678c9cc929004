"""A command's words to the call that they ask for; bad ones to one message."""

import inspect
import io
import re
import sys
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr
from functools import partial, wraps
from typing import Any

import tyro

from slider_jax.errors import InputError, nearest


def call_of(command: Callable[..., Any], words: Sequence[str], name: str) -> Callable[[], Any]:
    """`command` with the arguments that `words` give it.

    Raises `InputError` for words that cannot be used, and `SystemExit` after `--help`.
    """
    _refuse_unknown_options(command, words)

    @wraps(command)
    def call(*arguments: Any, **options: Any) -> Callable[[], Any]:
        return partial(command, *arguments, **options)

    style = tyro.conf.configure(tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff)
    said = io.StringIO()
    try:
        with redirect_stderr(said):
            asked = tyro.cli(style(call), args=words, prog=f"slider {name}")
    except SystemExit as end:
        if end.code == 2:
            raise InputError(f"{_in_one_line(said.getvalue())}; see slider {name} --help") from None
        raise
    print(said.getvalue(), end="", file=sys.stderr)
    return asked


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
            raise InputError(
                f"{option}: unknown option; allowed {', '.join(allowed)}{nearest(option, allowed)}"
            )


def _in_one_line(box: str) -> str:
    """Of what tyro draws between a title and a rule: the sentence, or the names that are missing.

    Its boxes have borders of their own on a terminal that has no UTF-8.
    """
    plain = re.sub(r"\x1b\[[0-9;]*m", "", box)
    rows = [row.strip("│╭╮╰╯").rstrip() for row in plain.splitlines()]
    ruled = [not row.strip(" ─-") for row in rows]
    begin = 2 if ruled[1:2] == [True] else 1
    rows = rows[begin : ruled.index(True, begin)] if True in ruled[begin:] else rows[begin:]
    if not rows:
        return plain.strip()
    depth = [len(row) - len(row.lstrip()) for row in rows]
    if rows[0].strip().startswith("Missing from"):
        names = [row.strip() for row, x in zip(rows, depth, strict=True) if x == depth[0] + 4]
        return f"{', '.join(names)}: missing"
    sentence = " ".join(row.strip() for row in rows)
    return sentence.removeprefix("Error parsing ").rstrip(".")
