"""An actuator whose moment was measured as a function of command and curvature."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.actuation.actuator import Couple
from slider_jax.actuation.waveform import Waveform


class MeasuredMoment(Couple):
    """The active moment M_act(command, kappa) from a table, with bilinear interpolation.

    M = EI kappa - M_act, so the table does not contain the elastic moment of the body. Outside the
    table, M_act is that of the nearest point in the table.
    """

    command: Waveform
    """The command in the unit of `commands`."""
    commands: Float[Array, " commands"]
    """Commands of the table's rows, increasing, in any unit."""
    curvatures: Float[Array, " curvatures"]
    """Curvatures kappa [1/m] of the table's columns, increasing."""
    moments: Float[Array, "commands curvatures"]
    """M_act [N m]."""

    def moment(self, x):
        row, share = _interval(self.commands, self.command.at(x.t))
        column, across = _interval(self.curvatures, x.kappa)
        low, high = (
            table[column] + across * (table[column + 1] - table[column])
            for table in (self.moments[row], self.moments[row + 1])
        )
        return self.place(x.s, x.ds)[1] * (low + share * (high - low))


def _interval(grid: Array, value: Array) -> tuple[Array, Array]:
    """Returns the index of the interval of `grid` that contains the value, and the share in it."""
    value = jnp.clip(value, grid[0], grid[-1])
    i = jnp.clip(jnp.searchsorted(grid, value, side="right") - 1, 0, grid.shape[0] - 2)
    return i, (value - grid[i]) / (grid[i + 1] - grid[i])
