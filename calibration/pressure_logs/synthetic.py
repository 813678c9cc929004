"""Synthetic logs of a chamber with known valves, in the format of the published firmware.

The pressure is integrated with eight explicit steps per sample. The integration shares no code with
the models that are fitted to the logs, so the logs are an independent test of these models.
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
"""Time between samples [s]."""
SUBSTEPS = 8
ATMOSPHERE = 101325.0
"""Absolute ambient pressure [Pa]."""
COUNT = PSI_PER_COUNT * PA_PER_PSI
ZERO = PSI_AT_ZERO * PA_PER_PSI


class Valves(NamedTuple):
    """A fill valve and a vent valve, with the parameters of the effect `firmware_valves`."""

    fill: float = 2.2
    vent: float = 1.9
    supply: float = 370e3
    critical: float = 0.32
    dead: float = 0.2

    def rate(self, p: float, error: float) -> float:
        """Returns dp/dt [Pa/s] at the gauge pressure p [Pa] and the error p_set - p [Pa]."""
        duty = min(250.0, 10.0 * abs(error) / COUNT) / 255.0
        opening = max(duty - self.dead, 0.0) / (1.0 - self.dead)
        inside, supply = ATMOSPHERE + p, ATMOSPHERE + self.supply
        if error > 0.0:
            return self.fill * opening * supply * self._flow(inside / supply)
        return -self.vent * opening * inside * self._flow(ATMOSPHERE / inside)

    def _flow(self, ratio: float) -> float:
        """Returns the flow divided by the choked flow; `ratio` is p_out/p_in (ISO 6358)."""
        beyond = max(0.0, (ratio - self.critical) / (1.0 - self.critical))
        return math.sqrt(max(0.0, 1.0 - beyond**2))


def valve_series(
    valves: Valves, frequency: float, cycles: float, noise: float, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Returns command and measured pressure (samples,) [counts] for a sine from 0 to 54 psi.

    `noise` is the standard deviation [counts] of the sensor. The first pressure has no noise.
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


def firmware_log(command: np.ndarray, pressure: np.ndarray, frequency: float) -> list[str]:
    """Returns the lines of a log of the published firmware, from command and pressure [counts].

    The valve duty of this firmware is ten times the error [counts], at most 250.
    """
    body = []
    for number, (c, p) in enumerate(zip(command, pressure, strict=True), start=1):
        error = c - p
        duty = int(min(250, 10 * abs(error)))
        fill, vent = (duty, 0) if error > 0 else (0, duty)
        body.append(f"{number},{fill},{vent},{c:.2f},{error:.2f},{p:.0f}")
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
    """Writes one log per frequency [Hz] to `folder`, and returns the paths of the logs."""
    folder = output_folder(folder)
    paths = []
    for i, f in enumerate(frequencies):
        path = folder / f"{f:g}.txt"
        series = valve_series(valves, f, cycles, noise, seed + i)
        write_bytes(path, ("\r".join(firmware_log(*series, f)) + "\r").encode())
        paths.append(path)
    return paths
