"""The recorder's process survives a killed program, and its own end is reported."""

import os
import signal
import time

import numpy as np
import pytest

from rig.errors import RigError
from rig.recording.reader import read_recording
from rig.recording.writer_process import ProcessRecorder
from tests.support.killed_writer import WRITER, printed_times, sent, start_program

PROGRAM = WRITER.replace(
    "rig.recording.writer import Recorder",
    "rig.recording.writer_process import ProcessRecorder as Recorder",
)


def test_a_recording_returns_all_pieces_times_and_settings(tmp_path):
    path = tmp_path / "a.h5"
    with ProcessRecorder(path, ("manifold", "force"), {"x": 1}) as recorder:
        sinks = [recorder.sink(name) for name in ("manifold", "force")]
        for i in range(3000):
            sinks[i % 2](i, b"%d" % i)
            recorder.check()
    found = read_recording(path)
    assert found.closed and found.settings == {"x": 1}
    for k, name in enumerate(("manifold", "force")):
        assert found.streams[name].pieces() == [b"%d" % i for i in range(k, 3000, 2)]
        assert found.streams[name].host_ns.tolist() == list(range(k, 3000, 2))
    assert recorder.load().recorded == {"manifold": 1500, "force": 1500}


def test_a_recording_is_never_overwritten(tmp_path):
    path = tmp_path / "a.h5"
    path.write_text("mine")
    with pytest.raises(RigError, match="exists already"):
        ProcessRecorder(path)
    assert path.read_text() == "mine"


def test_a_killed_recorder_is_reported_and_the_written_data_are_kept(tmp_path):
    path = tmp_path / "a.h5"
    recorder = ProcessRecorder(path, ("manifold",))
    sink, begun = recorder.sink("manifold"), time.monotonic()
    with pytest.raises(RigError, match="ended unexpectedly"):
        count = 0
        while time.monotonic() - begun < 10.0:
            sink(time.monotonic_ns(), b"x")
            count += 1
            if count == 200:
                killed = time.monotonic_ns()
                os.kill(recorder.pid, signal.SIGKILL)
            recorder.check()
            time.sleep(0.005)
    raised_after = time.monotonic() - begun
    recorder.close()
    found = read_recording(path).streams["manifold"]
    assert 1e-9 * (killed - found.host_ns[-1]) < 0.2 and raised_after < 8.0


def test_all_pieces_that_a_killed_program_sent_are_written(tmp_path):
    path, out = tmp_path / "a.h5", tmp_path / "out"
    with open(out, "wb") as file, start_program(PROGRAM, path, stdout=file) as program:
        while not path.exists():
            assert program.poll() is None
            time.sleep(0.01)
        time.sleep(1.0)
        program.kill()
    end = time.monotonic() + 20.0
    while not read_recording(path).closed:
        assert time.monotonic() < end
        time.sleep(0.05)
    for name, times in printed_times(out).items():
        stream = read_recording(path).streams[name]
        assert stream.pieces() == sent(name, len(stream.host_ns)) and len(times) > 300
        assert 1e-9 * (times[-1] - stream.host_ns[-1]) < 0.2
        assert np.all(np.diff(stream.host_ns) > 0)


def test_the_recorder_ignores_signals_that_the_program_handles(tmp_path):
    with ProcessRecorder(tmp_path / "a.h5", ("manifold",)) as recorder:
        for number in (signal.SIGINT, signal.SIGHUP):
            os.kill(recorder.pid, number)
        recorder.sink("manifold")(1, b"x")
        time.sleep(0.2)
        recorder.check()
    assert read_recording(tmp_path / "a.h5").streams["manifold"].pieces() == [b"x"]
