"""Implicit time schemes, each a sequence of backward-Euler-like stages.

Stage i of a step of length h solves the equations with every d(q)/dt written as
(q - reference_i)/(gamma h), where reference_i = base + weight_i (last - base), `base` is q at the
step's start and `last` the q found by the stage before.
"""

import math

import equinox as eqx


class Scheme(eqx.Module):
    """A diagonally implicit, stiffly accurate scheme: its last stage is the new state."""

    name: str = eqx.field(static=True)
    order: int = eqx.field(static=True)
    gamma: float = eqx.field(static=True)
    nodes: tuple[float, ...] = eqx.field(static=True)
    """Time of each stage as a fraction of the step; the last is 1."""
    weights: tuple[float, ...] = eqx.field(static=True)

    @property
    def stages(self) -> int:
        return len(self.nodes)


BACKWARD_EULER = Scheme("backward_euler", 1, 1.0, (1.0,), (0.0,))
"""First order, L-stable: the paper's scheme. Damps what it should keep: at 1 ms it loses 5 % of the
thrust at 4.8 Hz."""

_G = 1.0 - 1.0 / math.sqrt(2.0)
SDIRK2 = Scheme("sdirk2", 2, _G, (_G, 1.0), (0.0, (1.0 - _G) / _G))
"""Second order, L-stable, two stages that share gamma = 1 - 1/sqrt(2).

Source: Alexander, R. (1977), Diagonally implicit Runge-Kutta methods for stiff O.D.E.'s, SIAM J.
Numer. Anal. 14, 1006-1021."""

SCHEMES = {scheme.name: scheme for scheme in (BACKWARD_EULER, SDIRK2)}


def extrapolation(scheme: Scheme) -> list[list[float]]:
    """For each stage, weights of the last three solutions (oldest first) that predict its own."""
    times = [node - back for back in (3, 2, 1, 0) for node in scheme.nodes]
    rows = []
    for stage in range(scheme.stages):
        end = len(times) - scheme.stages + stage
        known, target = times[end - 3 : end], times[end]
        rows.append([math.prod((target - b) / (a - b) for b in known if b != a) for a in known])
    return rows
