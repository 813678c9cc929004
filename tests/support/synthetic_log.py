"""Synthetic logs in the rig's format, from a lag that the tests choose."""

import math
from pathlib import Path

import numpy as np

from calibration.pressure_logs.synthetic import PERIOD, firmware_log


def lagged(k, command, start, period=PERIOD):
    """Returns dp/dt = (c - p)/k for c linear between samples, by a loop over exact solutions."""
    p = [start]
    decay = math.exp(-period / k)
    for before, after in zip(command[:-1], command[1:], strict=True):
        slope = (after - before) / period
        p.append(decay * (p[-1] - before + slope * k) + after - slope * k)
    return np.array(p)


def lag_series(k=0.1, frequency=1.0, cycles=3.0, noise=1.7, seed=0, middle=290.0, amplitude=190.0):
    """Returns (command, pressure) in counts: a sine, and a lag's response with white noise.

    The first pressure, from which a free run starts, has no noise.
    """
    samples = round(cycles / frequency / PERIOD)
    t = PERIOD * np.arange(samples)
    command = np.round(middle + amplitude * np.sin(2 * math.pi * frequency * t + 0.3), 2)
    quiet = lagged(k, command, command[0] - 0.3 * amplitude)
    white = noise * np.random.default_rng(seed).normal(size=samples)
    return command, np.round(quiet + np.where(t > 0.0, white, 0.0))


def log_lines(k=0.1, frequency=1.0, **keywords):
    """Returns all lines of a log without a fault."""
    return firmware_log(*lag_series(k, frequency, **keywords), frequency)


def write_log(path: Path, lines, end="\r") -> Path:
    """Writes `lines`, each ended by `end`."""
    path.write_bytes((end.join(lines) + end).encode())
    return path
