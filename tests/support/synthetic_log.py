"""Logs in the rig's format, written by the tests, from a lag that the tests know."""

import math
from pathlib import Path

import numpy as np

from calibration.pressure_logs.synthetic import rows

COLUMNS = "N_sample,fluidInVoltage,fluidOutVoltage,pressureCommanded,pressureError,pressure"
PERIOD = 0.002


def lagged(k, command, start, period=PERIOD):
    """dp/dt = (c - p)/k, c linear between samples: the naive loop, with the exact exponentials."""
    p = [start]
    decay = math.exp(-period / k)
    for before, after in zip(command[:-1], command[1:], strict=True):
        slope = (after - before) / period
        p.append(decay * (p[-1] - before + slope * k) + after - slope * k)
    return np.array(p)


def series(k=0.1, frequency=1.0, cycles=3.0, noise=1.7, seed=0, middle=290.0, amplitude=190.0):
    """(command, pressure) in counts: a sine and what a lag makes of it, with white noise.

    The first pressure, from which a free run starts, is without noise.
    """
    samples = round(cycles / frequency / PERIOD)
    t = PERIOD * np.arange(samples)
    command = np.round(middle + amplitude * np.sin(2 * math.pi * frequency * t + 0.3), 2)
    quiet = lagged(k, command, command[0] - 0.3 * amplitude)
    white = noise * np.random.default_rng(seed).normal(size=samples)
    return command, np.round(quiet + np.where(t > 0.0, white, 0.0))


def log_lines(k=0.1, frequency=1.0, cycles=3.0, **keywords):
    """All lines of a log without a fault."""
    body = rows(*series(k, frequency, cycles, **keywords))
    stop = 1000 + round(1000 * cycles / frequency)
    head = [
        "-----NEW TEST-------",
        f"frequency:    {frequency:.6f} Hz",
        "start time    1000 ms",
        f"stop time     {stop} ms",
        "Sample Prd    2 ms",
        f"Number Cylces {cycles:g} ",
        COLUMNS,
    ]
    return [*head, *body, f"done{len(head) + len(body)}"]


def write(path: Path, lines, end="\r") -> Path:
    """Write `lines`, each ended by `end`."""
    path.write_bytes((end.join(lines) + end).encode())
    return path
