"""Runs the command line in a separate process, by default without JAX."""

import os
import signal
import subprocess
import sys
from contextlib import contextmanager

from tests.support.data import ROOT

HIDDEN = ("jax", "jaxlib", "equinox", "lineax", "optimistix", "diffrax", "optax")

WITHOUT_JAX = f"import sys; sys.modules.update(dict.fromkeys({HIDDEN})); "
"""An import of a hidden package raises ModuleNotFoundError."""

MAIN = "from slider_jax.cli.main import main; sys.exit(main(sys.argv[1:]))"


def slider(*words, timeout=120.0, code=WITHOUT_JAX):
    """Runs a command in a process without JAX, as on the rig's computer; returns the process."""
    return subprocess.run(
        [sys.executable, "-c", code + MAIN, *map(str, words)], capture_output=True, text=True,
        timeout=timeout, env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip


@contextmanager
def served(*words, cwd, code=WITHOUT_JAX):
    """Runs a command that prints a port and runs until Ctrl-C; yields the port."""
    child = subprocess.Popen(
        [sys.executable, "-u", "-c", code + MAIN, *map(str, words)],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=cwd,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    try:
        line = child.stdout.readline().split()
        assert line and line[0] == "port", line
        yield line[1]
    finally:
        child.send_signal(signal.SIGTERM)
        assert child.wait(20.0) in (0, -signal.SIGTERM)
        child.stdout.close()
