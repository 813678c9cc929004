"""Implicit time schemes: each step is a sequence of stages that resemble backward-Euler steps.

In stage i of a step of length h, every time derivative d(q)/dt is (q - reference_i)/(gamma h). Here
reference_i = base + weight_i (last - base), `base` is q at the start of the step, and `last` is q
from the previous stage.
"""

import math

import equinox as eqx


class Scheme(eqx.Module):
    """A diagonally implicit, stiffly accurate scheme: the last stage gives the new state."""

    name: str = eqx.field(static=True)
    order: int = eqx.field(static=True)
    gamma: float = eqx.field(static=True)
    nodes: tuple[float, ...] = eqx.field(static=True)
    """Time of each stage as a fraction of the step; the last fraction is 1."""
    weights: tuple[float, ...] = eqx.field(static=True)

    @property
    def stages(self) -> int:
        return len(self.nodes)


BACKWARD_EULER = Scheme("backward_euler", 1, 1.0, (1.0,), (0.0,))
"""The paper's scheme: first order, L-stable. With steps of 1 ms, numerical damping reduces the
thrust at 4.8 Hz by 5 %."""

_G = 1.0 - 1.0 / math.sqrt(2.0)
SDIRK2 = Scheme("sdirk2", 2, _G, (_G, 1.0), (0.0, (1.0 - _G) / _G))
"""Second order, L-stable, with two stages and gamma = 1 - 1/sqrt(2).

Source: Alexander, R. (1977), Diagonally implicit Runge-Kutta methods for stiff O.D.E.'s, SIAM J.
Numer. Anal. 14, 1006-1021."""

SCHEMES = {scheme.name: scheme for scheme in (BACKWARD_EULER, SDIRK2)}


def parabolas(scheme: Scheme) -> list[list[float]]:
    """Returns weights that extrapolate the last three solutions (oldest first) to each stage."""
    times = [node - back for back in (3, 2, 1, 0) for node in scheme.nodes]
    rows = []
    for stage in range(-scheme.stages, 0):
        known, target = times[stage - 3 : stage], times[stage]
        rows.append([math.prod((target - b) / (a - b) for b in known if b != a) for a in known])
    return rows


KNOWN = 4
"""Number of solutions that predict the next solution."""


def extrapolation(scheme: Scheme) -> list[list[float]]:
    """Returns weights that predict the solution of each stage from `KNOWN` solutions, oldest first.

    The prediction is the straight line through the last two solutions, plus the error of such a
    line in the same stage of the previous step. The error of a stage is nearly the same in
    successive steps. A parabola through three solutions of different stages would amplify it.
    """
    times = [node - back for back in (2, 1, 0) for node in scheme.nodes]
    rows = []
    for stage in range(-scheme.stages, 0):
        before, last, target = times[stage - 2], times[stage - 1], times[stage]
        slope = (target - last) / (last - before)
        row = [0.0] * KNOWN
        for past, sign in ((0, 1.0), (scheme.stages, -1.0)):
            row[KNOWN - 1 - past] += sign * (1.0 + slope)
            row[KNOWN - 2 - past] -= sign * slope
        row[KNOWN - scheme.stages] += 1.0
        rows.append(row)
    return rows
