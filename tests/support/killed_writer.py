"""A program with a recorder, for tests that kill it."""

import os
import subprocess
import sys

from tests.support.data import ROOT

WRITER = """
import os, sys, threading, time
from rig.recording.writer import Recorder

def feed(name, rate):
    sink, i = recorder.sink(name), 0
    while True:
        now = time.monotonic_ns()
        sink(now, b"%s %d;" % (name.encode(), i))
        os.write(1, b"%s %d\\n" % (name.encode(), now))
        i += 1
        time.sleep(1.0 / rate)

recorder = Recorder(sys.argv[1], ("manifold", "force"), {"trial": 1})
for stream in (("manifold", 500), ("force", 1000)):
    threading.Thread(target=feed, args=stream, daemon=True).start()
time.sleep(60.0)
"""
"""Records two streams and prints the host time of each piece."""


def start_program(code, *arguments, **keywords):
    return subprocess.Popen(
        [sys.executable, "-c", code, *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        **keywords,
    )


def sent(name, count):
    """Returns the first `count` pieces of a stream of `WRITER`."""
    return [b"%s %d;" % (name.encode(), i) for i in range(count)]


def printed_times(path):
    """Returns {stream: host times [ns]} from the output of `WRITER`, without an incomplete line."""
    times = {"manifold": [], "force": []}
    for line in path.read_text().splitlines(keepends=True):
        if line.endswith("\n"):
            name, ns = line.split()
            times[name].append(int(ns))
    return times
