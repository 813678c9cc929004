"""Tests of invalid arguments of a command line: exit code 2 and one line with the reason."""

import io
import subprocess
import sys
from dataclasses import fields

import pytest
from tyro import _errors as tyro_errors

from slider_jax.cli.main import main
from slider_jax.cli.parse import error_line

RUN = ("rig", "run", "x.toml", "--port", "x", "--out", "y")
SIMULATE = ("simulate", "x.toml", "--out", "y")
MATRIX = ("effects", "matrix", "x.toml", "--out", "y")
LONG = "/" + "a long folder/" * 12 + "two  blanks, one comma"


@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("rig", "watch"), "EXPERIMENT.toml, --port PORT: missing"),
        (("simulate",), "EXPERIMENT.toml|LOG.txt, --out DIR: missing"),
        (("simulate", "x.toml", "--out"), "--out: value missing"),
        ((*SIMULATE, LONG), f"unexpected arguments: {LONG}"),
        ((*SIMULATE, "--step", "abc"), "--step: given 'abc'; allowed a number of seconds"),
        ((*SIMULATE, "--nodes", "5.5"), "--nodes: given '5.5'; allowed a whole number"),
        ((*SIMULATE, "--drive", LONG), f"--drive: given {LONG!r}; allowed "),
        ((*SIMULATE, "--drive", "a\n\nb"), r"--drive: given 'a\n\nb'; allowed "),
        ((*SIMULATE, "--a\nb"), r"'--a\nb': unknown option; allowed --help, --out"),
        ((*RUN, "--limit", "250kPa"), "--limit: given '250kPa'; allowed pressures in Pa"),
        ((*MATRIX, "--phase", "0.1", "x"), "--phase: given '0.1 x'; allowed two numbers"),
        (
            ("rig", "log", "x", "--port", "p", "--out", "y"),
            "[HZ ...]: given 'x'; allowed frequencies",
        ),
    ],
)
def test_invalid_arguments_give_one_line(words, text, encoding, capsys, monkeypatch):
    """In both encodings, and on a terminal narrower than the line."""
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(io.BytesIO(), encoding=encoding))
    monkeypatch.setenv("COLUMNS", "60")
    assert main(words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"slider: error: {text}")
    assert line.endswith(
        f"; see slider {' '.join(words[: 1 + (words[0] != 'simulate')])} --help"
    ) or ("unknown option" in line)
    assert sys.stdout.tell() == 0


def test_the_events_of_tyro_have_the_fields_that_messages_use():
    """The events are private to tyro; this test fails first if a new version changes them."""
    for event, field in {
        "MissingArgs": "missing_arguments",
        "UnrecognizedArgs": "tokens",
        "InvalidChoice": "choices",
        "BadValue": "argument",
        "InstantiationFailure": "message",
    }.items():
        assert field in {x.name for x in fields(getattr(tyro_errors, event))}


def test_an_unknown_event_gives_one_line():
    assert error_line(tyro_errors.ParseErrorEvent("slider")) == "invalid arguments"


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ((*SIMULATE, "--node", "5"), "; did you mean --nodes?"),
        ((*SIMULATE, "--xyzzy", "5"), "--scheme, --drive, --effects"),
        (("simulat", "x.toml"), "; did you mean simulate?; see slider --help"),
        (("matrix",), "; did you mean effects matrix?; see slider --help"),
        (("rig", "chek"), "rig simulate; did you mean rig check?; see slider --help"),
        (("foo",), "rig simulate; see slider --help"),
    ],
)
def test_an_unknown_name_gives_a_message_with_a_similar_name(words, text, capsys):
    assert main(words) == 2
    assert capsys.readouterr().err.strip().endswith(text)


def test_negative_numbers_are_read_as_values(capsys):
    words = (*MATRIX, "--phase", "-0.3", "0.3", "--separate", "leakage", "orifice_flow")
    assert main(words) == 2
    assert "x.toml: no such file" in capsys.readouterr().err


@pytest.mark.parametrize("word", ["effects", "--help"])
def test_a_reader_that_ends_early_causes_no_traceback(word):
    """As in `slider effects | head -1`."""
    command = [sys.executable, "-m", "slider_jax.cli.main", word]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 141
