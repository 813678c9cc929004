"""Compiles the firmware for this computer, sends requests to it and reads the replies."""

import shutil
import struct
import subprocess
from pathlib import Path
from typing import NamedTuple

import pytest

HERE = Path(__file__).resolve().parent
SKETCH = HERE.parents[1] / "rig" / "firmware" / "manifold"
STRICT = ("-std=c++17", "-Wall", "-Wextra", "-Werror", "-O1")
SANITIZED = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")
Request = tuple[bytes, int, bytes]
"""Kind, device time [us], payload; tests/support/firmware/host.cpp lists the kinds."""


class Reply(NamedTuple):
    """The bytes that the core sent after a request, and its state then."""

    sent: bytes
    state: int
    pressures: tuple[int, ...]
    damaged: int
    lost: int


class Pass(NamedTuple):
    """The bytes, valve duties (0 to 255) and watchdog feeds after a pass of the sketch's loop."""

    sent: bytes
    fill: tuple[int, ...]
    vent: tuple[int, ...]
    fed: int


def compiler() -> str:
    """Returns the path of g++ or clang++; skip the test if neither is installed."""
    found = shutil.which("g++") or shutil.which("clang++")
    if found is None:
        pytest.skip("no g++ or clang++ to compile the firmware for this computer")
    return found


def build(source: str, folder: Path, *flags: str) -> Path:
    """Compiles tests/support/firmware/`source` with the firmware; returns the program."""
    program = folder / Path(source).stem
    includes = ("-I", str(SKETCH), "-I", str(HERE / "firmware"))
    parts = (str(HERE / "firmware" / source), *map(str, sorted(SKETCH.glob("*.cpp"))))
    command = [compiler(), *STRICT, *flags, *includes, *parts, "-o", str(program)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return program


def sanitizers(folder: Path) -> tuple[str, ...]:
    """Returns the flags of the sanitizers, or none if the compiler lacks their libraries."""
    empty = folder / "empty.cpp"
    empty.write_text("int main() {}\n")
    command = [compiler(), *SANITIZED, str(empty), "-o", str(folder / "empty")]
    return () if subprocess.run(command, capture_output=True).returncode else SANITIZED


def _run(program: Path, given: bytes) -> bytes:
    done = subprocess.run([program], input=given, capture_output=True)
    assert done.returncode == 0, done.stderr.decode()
    return done.stdout


def ask(program: Path, requests: list[Request]) -> list[Reply]:
    """Returns the replies of host.cpp, one per request."""
    heads = [kind + struct.pack("<QH", now, len(data)) + data for kind, now, data in requests]
    output, at, replies = _run(program, b"".join(heads)), 0, []
    while at < len(output):
        start = at + 2
        end = start + struct.unpack_from("<H", output, at)[0]
        state, *pressures, damaged, lost = struct.unpack_from("<B4iII", output, end)
        replies.append(Reply(output[start:end], state, tuple(pressures), damaged, lost))
        at = end + 25
    assert len(replies) == len(requests)
    return replies


def run_sketch(program: Path, passes: list[tuple[int, list[int], int, bytes]]) -> list[Pass]:
    """Returns the results of sketch.cpp: of `setup`, then per pass (time [us], 8 counts, room,
    bytes)."""
    given = b"".join(
        struct.pack("<Q8HHH", now, *counts, room, len(data)) + data
        for now, counts, room, data in passes
    )
    output, at, done = _run(program, given), 0, []
    while at < len(output):
        start = at + 2
        end = start + struct.unpack_from("<H", output, at)[0]
        *duties, fed = struct.unpack_from("<8BI", output, end)
        done.append(Pass(output[start:end], tuple(duties[:4]), tuple(duties[4:]), fed))
        at = end + 12
    assert len(done) == 1 + len(passes)
    return done
