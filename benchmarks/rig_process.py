"""Runs `slider` commands as separate processes, with a simulated rig."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def command(*words: object) -> list[str]:
    """Returns the command line of a `slider` command in this Python."""
    code = "import sys; from slider_jax.cli.main import main; sys.exit(main(sys.argv[1:]))"
    return [sys.executable, "-c", code, *map(str, words)]


@contextmanager
def simulated(truth: Path, folder: Path, *options: object) -> Iterator[tuple[str, Path]]:
    """Runs `slider rig simulate` with an experiment. Yields the port, and the rig file in `folder`.

    The process ends with the block, also after SIGTERM. Raises `RuntimeError` if the process does
    not start. The message of the process on stderr gives the reason.
    """
    rig = folder / "rig.toml"
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    child = subprocess.Popen(
        command("rig", "simulate", truth, "--rig-file", rig, *options),
        stdout=subprocess.PIPE, text=True, env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    try:
        assert child.stdout is not None
        words = child.stdout.readline().split()
        if words[:1] != ["port"]:
            raise RuntimeError(f"slider rig simulate {truth} did not start")
        yield words[1], rig
    finally:
        child.terminate()
        try:
            child.wait(20.0)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
        signal.signal(signal.SIGTERM, before)
