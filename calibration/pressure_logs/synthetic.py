"""Logs of a chamber whose valves are known, in the format of the rig's firmware.

Integrated by explicit steps of an eighth of a sample, by other code than what is fitted to them.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calibration.pressure_logs.read import PA_PER_PSI, PSI_AT_ZERO, PSI_PER_COUNT
from calibration.pressure_logs.rows import COLUMNS
from slider_jax.io.files import output_folder, write_bytes

PERIOD = 0.002
"""Between samples [s]."""
SUBSTEPS = 8
ROOM = 101325.0
COUNT = PSI_PER_COUNT * PA_PER_PSI
ZERO = PSI_AT_ZERO * PA_PER_PSI


class Valves(NamedTuple):
    """A fill and a vent valve, as `slider_jax.effects.pneumatics.firmware_valves` names their
    numbers."""

    fill: float = 2.2
    vent: float = 1.9
    supply: float = 370e3
    critical: float = 0.32
    dead: float = 0.2

    def rate(self, p: float, error: float) -> float:
        """dp/dt [Pa/s] at the gauge pressure p and the error p_set - p [Pa]."""
        duty = min(250.0, 10.0 * abs(error) / COUNT) / 255.0
        opening = max(duty - self.dead, 0.0) / (1.0 - self.dead)
        inside, supply = ROOM + p, ROOM + self.supply
        if error > 0.0:
            return self.fill * opening * supply * self._passes(inside / supply)
        return -self.vent * opening * inside * self._passes(ROOM / inside)

    def _passes(self, ratio: float) -> float:
        beyond = max(0.0, (ratio - self.critical) / (1.0 - self.critical))
        return math.sqrt(max(0.0, 1.0 - beyond**2))


def series(
    valves: Valves, frequency: float, cycles: float, noise: float, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Command and measured pressure in codes, under a sine from 0 to 54 psi.

    `noise` is the sensor's, in codes; the first pressure is without.
    """
    t = PERIOD * np.arange(round(cycles / frequency / PERIOD))
    command = np.round(290.0 + 195.0 * np.sin(2.0 * math.pi * frequency * t + 0.3), 2)
    wanted = COUNT * command + ZERO
    p = [COUNT * 300.0 + ZERO]
    for before, after in zip(wanted[:-1], wanted[1:], strict=True):
        now = p[-1]
        for i in range(SUBSTEPS):
            error = before + (after - before) * (i + 0.5) / SUBSTEPS - now
            now += PERIOD / SUBSTEPS * valves.rate(now, error)
        p.append(now)
    white = np.where(t > 0.0, noise, 0.0) * np.random.default_rng(seed).normal(size=len(t))
    return command, np.round((np.array(p) - ZERO) / COUNT + white)


def rows(command: np.ndarray, pressure: np.ndarray, first: int = 1) -> list[str]:
    """The rows as the firmware writes them: the duty is ten times the error, at most 250."""
    found = []
    for number, (c, p) in enumerate(zip(command, pressure, strict=True), start=first):
        error = c - p
        duty = int(min(250, 10 * abs(error)))
        fill, vent = (duty, 0) if error > 0 else (0, duty)
        found.append(f"{number},{fill},{vent},{c:.2f},{error:.2f},{p:.0f}")
    return found


def lines(command: np.ndarray, pressure: np.ndarray, frequency: float) -> list[str]:
    """A whole log."""
    body = rows(command, pressure)
    cycles = len(command) * PERIOD * frequency
    head = [
        "-----NEW TEST-------",
        f"frequency:    {frequency:.6f} Hz",
        "start time    1000 ms",
        f"stop time     {1000 + round(1000 * len(command) * PERIOD)} ms",
        f"Sample Prd    {1000 * PERIOD:g} ms",
        f"Number Cylces {cycles:g} ",
        ",".join(COLUMNS),
    ]
    return [*head, *body, f"done{len(head) + len(body)}"]


def write_logs(
    folder: Path,
    valves: Valves = Valves(),
    frequencies: Sequence[float] = (0.8, 1.1, 1.5, 2.0, 2.6),
    cycles: float = 4.0,
    noise: float = 1.7,
    seed: int = 0,
) -> list[Path]:
    """Write a log a frequency into `folder`; returns their paths."""
    folder = output_folder(folder)
    paths = []
    for i, f in enumerate(frequencies):
        path = folder / f"{f:g}.txt"
        text = "\r".join(lines(*series(valves, f, cycles, noise, seed + i), f)) + "\r"
        write_bytes(path, text.encode())
        paths.append(path)
    return paths
