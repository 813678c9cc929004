"""Tests of a command's progress messages."""

import time

import pytest

from slider_jax.cli import progress
from slider_jax.cli.progress import Progress


@pytest.mark.parametrize("quick, text", [(False, "still.csv: compiling ...\n"), (True, "")])
def test_a_slow_start_is_reported(quick, text, monkeypatch, capsys):
    monkeypatch.setattr(progress, "PATIENCE", 0.4)
    with Progress("still.csv", "step") as bar:
        if quick:
            bar.to(1, 2)
        time.sleep(0.6)
    assert capsys.readouterr().err == text


def test_lines_count_the_steps_of_an_earlier_run_and_omit_the_last_step(monkeypatch, capsys):
    monkeypatch.setattr(progress, "PAUSE", 0.0)
    with Progress("9 designs", "stride") as bar:
        bar.begin(6, 3)
        for _ in range(3):
            bar.step()
    text = capsys.readouterr().err
    assert text == "9 designs: 4 of 6 strides\n9 designs: 5 of 6 strides\n"


def test_a_quick_command_prints_no_progress(capsys):
    with Progress("quick", "step") as bar:
        for done in range(1, 101):
            bar.to(done, 100)
    assert capsys.readouterr().err == ""


def test_on_a_terminal_the_bar_first_shows_the_current_activity(monkeypatch, capsys):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    with Progress("still.csv", "step") as bar:
        bar.to(3, 7)
        bar._bar.refresh()
    text = capsys.readouterr().err
    assert text.index("still.csv: compiling") < text.index("still.csv:  43%|") and "3/7" in text
