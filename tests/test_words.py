"""Words of a command line that cannot be used: exit code 2 and one line that says why."""

import pytest

from slider_jax.cli.main import main

RUN = ("rig", "run", "x.toml", "--port", "x", "--out", "y")
SIMULATE = ("simulate", "x.toml", "--out", "y")
MATRIX = ("effects", "matrix", "x.toml", "--out", "y")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("rig", "watch"), "EXPERIMENT.toml, --port PORT: missing"),
        (("simulate",), "EXPERIMENT.toml|LOG.txt, --out DIR: missing"),
        (("simulate", "x.toml", "--out"), "Missing value for argument '--out'"),
        ((*SIMULATE, "more"), "Unrecognized options: more"),
        ((*SIMULATE, "--step", "abc"), "--step: given 'abc'; allowed a number of seconds"),
        ((*SIMULATE, "--nodes", "5.5"), "--nodes: given '5.5'; allowed a whole number"),
        ((*SIMULATE, "--drive", "soft"), "invalid choice 'soft' for argument '--drive'"),
        ((*RUN, "--limit", "250kPa"), "--limit: given '250kPa'; allowed pressures in Pa"),
        ((*MATRIX, "--phase", "0.1", "x"), "--phase: given '0.1 x'; allowed two numbers"),
    ],
)
def test_words_that_cannot_be_used_are_told_in_one_line(words, said, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "60")  # a narrow terminal, where boxes are wrapped
    assert main(words) == 2
    out, error = capsys.readouterr()
    (line,) = error.splitlines()
    assert line.startswith(f"slider: error: {said}")
    assert line.endswith(
        f"; see slider {' '.join(words[: 1 if words[0] == 'simulate' else 2])} --help"
    )
    assert out == ""


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((*SIMULATE, "--node", "5"), "; did you mean --nodes?"),
        ((*SIMULATE, "--trial", "5"), "--scheme, --drive"),
        (("simulat", "x.toml"), "; did you mean simulate?; see slider --help"),
        (("foo",), "; see slider --help"),
    ],
)
def test_an_unknown_name_is_told_of_one_like_it(words, said, capsys):
    assert main(words) == 2
    assert capsys.readouterr().err.strip().endswith(said)


def test_negative_numbers_are_values(capsys):
    assert main((*MATRIX, "--phase", "-0.3", "0.3", "--separate", "leakage", "orifice_flow")) == 2
    assert "x.toml: no such file" in capsys.readouterr().err
