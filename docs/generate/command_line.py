"""Generates the page of the command-line reference from the help text of each command."""

import io
import os
from contextlib import redirect_stdout
from textwrap import fill

from slider_jax.cli.commands import COMMANDS, function_of
from slider_jax.cli.parse import call_of

PAGE = "reference/command_line.md"
WIDTH = 88
"""Width of the help texts in characters; about as many fit beside the site's two side bars."""


def help_text(name: str) -> str:
    """Returns what `slider NAME --help` prints."""
    text = io.StringIO()
    before = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = str(WIDTH)
    try:
        with redirect_stdout(text):
            call_of(function_of(COMMANDS[name].target), ["--help"], name)
    except SystemExit:
        pass
    finally:
        if before is None:
            del os.environ["COLUMNS"]
        else:
            os.environ["COLUMNS"] = before
    # tyro does not wrap the description.
    lines = text.getvalue().strip().splitlines()
    return "\n".join(line.rstrip() if len(line) <= WIDTH else fill(line, WIDTH) for line in lines)


def pages() -> dict[str, str]:
    """Returns a dictionary from the path of the command-line page to its text."""
    lines = [
        "# Command line",
        "",
        "`slider COMMAND --help` prints the text that this page shows for each command. The exit",
        "code is 0 after success, 2 for invalid input or a failed solution, and 130 after an",
        "interruption. The [gallery](../gallery.md) shows a run of each command.",
    ]
    for name in sorted(COMMANDS):
        lines += ["", f"## slider {name}", "", "```text", help_text(name), "```"]
    return {PAGE: "\n".join([*lines, ""])}
