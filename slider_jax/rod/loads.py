"""The loads of a rod: a force and a moment on the tip, weight, and tendons or pressure chambers."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slider_jax.rod.rod import Rod, RodShape, stretch_of


class RodTendon(eqx.Module):
    """A tendon that slides without friction along a line beside the axis of the rod.

    A pressure chamber is a tendon that pushes: its tension is -p A, with the pressure p and the
    area A at the chamber's distance d from the axis. Its moment per unit pressure is K_Q = A d.
    """

    offset: Float[Array, "cells 2"]
    """Position (n, b) [m] of the tendon in the section of each cell."""
    offset_slope: Float[Array, "cells 2"]
    """Change of the position along the rod, d(n, b)/ds [-]."""
    share: Float[Array, " cells"]
    """Part of each cell along which the tendon runs, 0 to 1."""
    tension: Float[Array, ""]
    """Tension [N]; negative if the tendon pushes."""

    def length(self, rod: Rod, strains: Float[Array, "cells q"]) -> Float[Array, ""]:
        """Returns the length [m] of the tendon along a rod with constant strains in each cell."""
        n, b = self.offset.T
        twist, about_n, about_b = strains[:, :3].T
        along = jnp.stack(
            [
                stretch_of(strains) + about_n * b - about_b * n,
                self.offset_slope[:, 0] - twist * b,
                self.offset_slope[:, 1] + twist * n,
            ]
        )
        return jnp.sum(jnp.sqrt(jnp.sum(along**2, axis=0)) * self.share * rod.ds)


def covered_share(span, edges: np.ndarray) -> np.ndarray:
    """Returns the part of each cell that lies in the span, 0 to 1; `edges` [m] bound the cells."""
    inside = np.minimum(edges[1:], span[1]) - np.maximum(edges[:-1], span[0])
    return np.clip(inside, 0.0, None) / np.diff(edges)


def covered_middle(span, edges: np.ndarray) -> np.ndarray:
    """Returns the middle [m] of the part of each cell that lies in the span."""
    return 0.5 * (np.clip(edges[1:], *span) + np.clip(edges[:-1], *span))


def straight_tendon(span, start, end, tension, edges: np.ndarray) -> RodTendon:
    """Returns the tendon along `span` [m] that runs from the place (n, b) `start` to `end` [m].

    `edges` [m] are the ends of the cells, from the clamp.
    """
    start, end = np.array(start), np.array(end)
    slope = (end - start) / (span[1] - span[0])
    ahead = covered_middle(span, edges) - span[0]
    return RodTendon(
        offset=jnp.asarray(start + ahead[:, None] * slope),
        offset_slope=jnp.tile(jnp.asarray(slope), (len(ahead), 1)),
        share=jnp.asarray(covered_share(span, edges)),
        tension=jnp.asarray(tension),
    )


class RodLoads(eqx.Module):
    """Loads of a rod. A follower load turns with the tip; other loads keep their direction."""

    force: Float[Array, "3"]
    """Force [N] on the tip, in space. A follower force has this direction at the unloaded tip."""
    moment: Float[Array, "3"]
    """Moment [N m] on the tip; otherwise like `force`."""
    down: Float[Array, "3"]
    """Unit vector in the direction of the weight."""
    tendons: tuple[RodTendon, ...] = ()
    follower: bool = eqx.field(static=True, default=False)

    def on_tip(
        self, tip: Float[Array, "3 3"], unloaded: Float[Array, "3 3"]
    ) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
        """Returns force and moment in space after the tip turned from `unloaded` to `tip`."""
        if not self.follower:
            return self.force, self.moment
        turn = tip @ unloaded.T
        return turn @ self.force, turn @ self.moment

    def potential(
        self, rod: Rod, strains: Float[Array, "cells q"], shape: RodShape
    ) -> Float[Array, ""]:
        """Returns the potential energy [J] of weight and tendons."""
        middle = 0.5 * (shape.position[1:] + shape.position[:-1])
        energy = -jnp.sum(rod.weight * rod.ds * (middle @ self.down))
        for tendon in self.tendons:
            energy = energy + tendon.tension * tendon.length(rod, strains)
        return energy
