"""Processes that share a folder: no job is computed twice, and a killed process is replaced."""

import os
import signal
import subprocess
import sys
import time

import pytest

from slider_jax.io import sharing
from slider_jax.io.files import write_first
from slider_jax.io.sharing import SharedFolder
from tests.support.data import ROOT

CODE = """
import sys, time
from pathlib import Path
from slider_jax.io import sharing
folder, log, count, seconds, patience = sys.argv[1:]
sharing.RENEWED, sharing.CLAIM_LIFETIME, sharing.PAUSE = 0.1, float(patience), 0.02

def work(name):
    with open(log, "a") as file:
        file.write(name + " begun\\n")
    time.sleep(float(seconds))
    return name.encode()

with sharing.SharedFolder(Path(folder)) as shared:
    shared.compute([f"job_{i}" for i in range(int(count))], work)
"""


def started(folder, log, count, seconds, patience=5.0):
    words = [str(x) for x in (folder, log, count, seconds, patience)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen([sys.executable, "-c", CODE, *words], env=environment, cwd=ROOT)


def wait_for(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def begun(log):
    return log.read_text().splitlines() if log.exists() else []


def test_three_processes_compute_each_job_once(tmp_path):
    logs = [tmp_path / f"log_{i}" for i in range(3)]
    runs = [started(tmp_path / "shared", log, 24, 0.1) for log in logs]
    assert [run.wait(timeout=120) for run in runs] == [0, 0, 0]
    done = [line for log in logs for line in begun(log)]
    assert len(done) == len(set(done)) == 24
    assert all(begun(log) for log in logs)
    assert sorted(x.name for x in (tmp_path / "shared").iterdir()) == sorted(
        f"job_{i}" for i in range(24)
    )


def test_the_jobs_of_a_killed_process_are_taken_over(tmp_path):
    first = started(tmp_path / "shared", tmp_path / "first", 2, 1000.0)
    wait_for(lambda: begun(tmp_path / "first"))
    (its,) = begun(tmp_path / "first")
    second = started(tmp_path / "shared", tmp_path / "second", 2, 0.0, patience=2.0)
    wait_for(lambda: begun(tmp_path / "second"))
    time.sleep(3.0)  # longer than the patience, but the first process renews its claim
    (other,) = begun(tmp_path / "second")
    assert {its, other} == {"job_0 begun", "job_1 begun"} and second.poll() is None
    first.send_signal(signal.SIGKILL)
    first.wait()
    assert second.wait(timeout=60) == 0
    assert begun(tmp_path / "second") == [other, its]
    files = {x.name: x.read_bytes() for x in (tmp_path / "shared").iterdir()}
    assert files == {"job_0": b"job_0", "job_1": b"job_1"}


def test_a_claim_of_another_computer_is_void_if_it_is_not_renewed(tmp_path, monkeypatch):
    monkeypatch.setattr(sharing, "CLAIM_LIFETIME", 0.2)
    claim = tmp_path / "job.claim0"
    claim.write_text("another_computer 1\n")
    with SharedFolder(tmp_path) as shared:
        for i in range(10):
            assert not shared.take("job")
            time.sleep(0.05)
            os.utime(claim, (i, i))
        assert not shared.take("job")
        time.sleep(0.3)
        assert shared.take("job")
        with SharedFolder(tmp_path) as late:
            assert not late.take("job")


def test_a_claim_that_was_given_up_before_a_later_claim_leaves_no_gap(tmp_path):
    (tmp_path / "job.claim1").write_text("another_computer 1\n")
    with SharedFolder(tmp_path) as shared:
        assert not shared.take("job")


def test_work_that_ends_before_the_claim_is_not_repeated(tmp_path):
    answers = iter([False, True])
    with SharedFolder(tmp_path) as shared:
        shared.alone("result", lambda: next(answers), lambda: pytest.fail("the work is done"))
    assert not list(tmp_path.iterdir())


def test_a_job_that_fails_is_free_again(tmp_path):
    def fails(name):
        raise ZeroDivisionError

    for _ in range(2):
        with pytest.raises(ZeroDivisionError), SharedFolder(tmp_path) as shared:
            shared.compute(["job"], fails)
    with SharedFolder(tmp_path) as shared:
        shared.compute(["job"], lambda name: b"2")
    assert (tmp_path / "job").read_bytes() == b"2"


def test_work_that_another_process_does_alone_is_not_repeated(tmp_path, monkeypatch):
    monkeypatch.setattr(sharing, "PAUSE", 0.001)
    calls = []

    def other_finishes():
        calls.append("asked")
        if len(calls) == 3:
            other.give_up("result")
            (tmp_path / "written").touch()
        return (tmp_path / "written").exists()

    with SharedFolder(tmp_path) as other, SharedFolder(tmp_path) as shared:
        assert other.take("result")
        shared.alone("result", other_finishes, lambda: calls.append("worked"))
        assert calls == ["asked"] * 3
        (tmp_path / "written").unlink()
        shared.alone("result", (tmp_path / "written").exists, lambda: calls.append("worked"))
    assert calls[-1] == "worked"


def test_only_the_first_process_writes_the_settings(tmp_path):
    assert write_first(tmp_path / "settings.json", b"first")
    assert not write_first(tmp_path / "settings.json", b"second")
    assert (tmp_path / "settings.json").read_bytes() == b"first"
    assert [x.name for x in tmp_path.iterdir()] == ["settings.json"]
