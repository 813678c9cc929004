"""The loads of a rod: a force and a moment on the tip, weight, and tendons or pressure chambers."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slider_jax.rod.rod import GAUSS, Rod, RodShape, gauss_points, half_cells, stretch_of


class RodTendon(eqx.Module):
    """A tendon that slides without friction along a line beside the axis of the rod.

    A pressure chamber is a tendon that pushes: its tension is -p A, with the pressure p and the
    area A at the chamber's distance d from the axis. Its moment per unit pressure is K_Q = A d.
    """

    offset: Float[Array, "points 2"]
    """Position (n, b) [m] of the tendon in the section of each point."""
    offset_slope: Float[Array, "points 2"]
    """Change of the position along the rod, d(n, b)/ds [-]."""
    share: Float[Array, " points"]
    """Part of each half cell along which the tendon runs, 0 to 1."""
    tension: Float[Array, ""]
    """Tension [N]; negative if the tendon pushes."""

    def length(self, rod: Rod, strains: Float[Array, "points q"]) -> Float[Array, ""]:
        """Returns the length [m] of the tendon along the rod; of fourth order in the cells."""
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
    """Returns the part of each half cell that lies in the span; `edges` [m] bound the cells."""
    halves = half_cells(edges)
    inside = np.minimum(halves[1:], span[1]) - np.maximum(halves[:-1], span[0])
    return np.clip(inside, 0.0, None) / np.diff(halves)


def straight_tendon(span, start, end, tension, edges: np.ndarray) -> RodTendon:
    """Returns the tendon along `span` [m] that runs from the place (n, b) `start` to `end` [m].

    `edges` [m] are the ends of the cells, from the clamp.
    """
    start, end = np.array(start), np.array(end)
    slope = (end - start) / (span[1] - span[0])
    ahead = np.clip(gauss_points(edges), *span) - span[0]
    return RodTendon(
        offset=jnp.asarray(start + ahead[:, None] * slope),
        offset_slope=jnp.tile(jnp.asarray(slope), (len(ahead), 1)),
        share=jnp.asarray(covered_share(span, edges)),
        tension=jnp.asarray(tension),
    )


def weighted_place(
    rod: Rod, strains: Float[Array, "points q"], shape: RodShape
) -> Float[Array, "3"]:
    """Returns the integral of weight times position [N m]; of fourth order in the cells."""
    near, far = rod.weight[::2], rod.weight[1::2]
    length = 2.0 * rod.ds[::2]
    stretch = stretch_of(strains).reshape(-1, 2)
    # The stretch is linear in a cell: its values at both ends of the cell.
    outwards = (0.5 / GAUSS - 0.5) * (stretch[:, 1] - stretch[:, 0])
    slopes = shape.frame[:, :, 0]
    bow = (stretch[:, 0] - outwards)[:, None] * slopes[:-1]
    bow = bow - (stretch[:, 1] + outwards)[:, None] * slopes[1:]
    begin, end = shape.position[:-1], shape.position[1:]
    mean = 0.5 * (begin + end) + length[:, None] / 12.0 * bow
    skew = (far - near) / (12.0 * GAUSS)
    return ((0.5 * (near + far) * length) @ mean) + (skew * length) @ (end - begin)


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
