"""The firmware compiled for this computer: what its programs are asked, and what they say."""

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
"""Kind, device time [us], payload: the head of tests/firmware/host.cpp has the kinds."""


class Reply(NamedTuple):
    """What the core said to a request, and how it stood then."""

    said: bytes
    state: int
    pressures: tuple[int, ...]
    damaged: int
    lost: int


class Pass(NamedTuple):
    """What the sketch did in a pass of its loop; duties of 255."""

    said: bytes
    fill: tuple[int, ...]
    vent: tuple[int, ...]
    fed: int


def compiler() -> str:
    """g++ or clang++; skips the test where there is neither."""
    found = shutil.which("g++") or shutil.which("clang++")
    if found is None:
        pytest.skip("no g++ or clang++ to compile the firmware for this computer")
    return found


def build(source: str, folder: Path, *flags: str) -> Path:
    """The program of tests/firmware/`source` with the firmware's parts."""
    program = folder / Path(source).stem
    includes = ("-I", str(SKETCH), "-I", str(HERE / "firmware"))
    parts = (str(HERE / "firmware" / source), *map(str, sorted(SKETCH.glob("*.cpp"))))
    command = [compiler(), *STRICT, *flags, *includes, *parts, "-o", str(program)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return program


def sanitizers(folder: Path) -> tuple[str, ...]:
    """The flags of the sanitizers; none where the compiler lacks their libraries."""
    empty = folder / "empty.cpp"
    empty.write_text("int main() {}\n")
    command = [compiler(), *SANITIZED, str(empty), "-o", str(folder / "empty")]
    return () if subprocess.run(command, capture_output=True).returncode else SANITIZED


def _run(program: Path, given: bytes) -> bytes:
    done = subprocess.run([program], input=given, capture_output=True)
    assert done.returncode == 0, done.stderr.decode()
    return done.stdout


def ask(program: Path, requests: list[Request]) -> list[Reply]:
    """The replies of host.cpp, one a request."""
    heads = [kind + struct.pack("<QH", now, len(data)) + data for kind, now, data in requests]
    told, at, replies = _run(program, b"".join(heads)), 0, []
    while at < len(told):
        start = at + 2
        end = start + struct.unpack_from("<H", told, at)[0]
        state, *pressures, damaged, lost = struct.unpack_from("<B4iII", told, end)
        replies.append(Reply(told[start:end], state, tuple(pressures), damaged, lost))
        at = end + 25
    assert len(replies) == len(requests)
    return replies


def run_sketch(program: Path, passes: list[tuple[int, list[int], int, bytes]]) -> list[Pass]:
    """What sketch.cpp did: first of `setup`, then of each (time [us], 8 counts, room, bytes)."""
    given = b"".join(
        struct.pack("<Q8HHH", now, *counts, room, len(data)) + data
        for now, counts, room, data in passes
    )
    told, at, done = _run(program, given), 0, []
    while at < len(told):
        start = at + 2
        end = start + struct.unpack_from("<H", told, at)[0]
        *duties, fed = struct.unpack_from("<8BI", told, end)
        done.append(Pass(told[start:end], tuple(duties[:4]), tuple(duties[4:]), fed))
        at = end + 12
    assert len(done) == 1 + len(passes)
    return done
