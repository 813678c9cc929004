"""What a command says of how far it is, where stderr is not a terminal."""

import time

import pytest

from slider_jax.cli import progress
from slider_jax.cli.progress import Progress


@pytest.mark.parametrize("quick, said", [(False, "still.csv: compiling ...\n"), (True, "")])
def test_what_is_awaited_is_said_if_it_takes_long(quick, said, monkeypatch, capsys):
    monkeypatch.setattr(progress, "PATIENCE", 0.4)
    with Progress("still.csv", "step") as bar:
        if quick:
            bar.to(1, 2)
        time.sleep(0.6)
    assert capsys.readouterr().err == said


def test_lines_count_what_was_done_before_but_not_the_end(monkeypatch, capsys):
    monkeypatch.setattr(progress, "PAUSE", 0.0)
    with Progress("9 members", "stride") as bar:
        bar.begin(6, 3)
        for _ in range(3):
            bar.step()
    said = capsys.readouterr().err
    assert said == "9 members: 4 of 6 strides\n9 members: 5 of 6 strides\n"


def test_a_quick_command_is_silent(capsys):
    with Progress("quick", "step") as bar:
        for done in range(1, 101):
            bar.to(done, 100)
    assert capsys.readouterr().err == ""


def test_a_terminal_gets_a_bar_that_first_says_what_it_waits_for(monkeypatch, capsys):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    with Progress("still.csv", "step") as bar:
        bar.to(3, 7)
        bar._bar.refresh()
    said = capsys.readouterr().err
    assert said.index("still.csv: compiling") < said.index("still.csv:  43%|") and "3/7" in said
