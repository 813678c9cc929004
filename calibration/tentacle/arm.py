"""The arm: a cone of soft material that hangs from its thick end, with two tendons in its wall.

Source of dimensions and frames: github.com/tud-phi/soromox, folder
paper_results/secVa_system_identification (MIT).
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from slider_jax.beam.parameters import G
from slider_jax.rod.equilibrium import RodEquilibrium, equilibrium
from slider_jax.rod.loads import RodLoads, RodTendon, straight_tendon
from slider_jax.rod.rod import Rod, gauss_points, half_cells

LENGTH, TENDON_END = 0.360, 0.305
"""Lengths [m] of the arm, and of the part with tendons."""
RADII = ((0.0, 0.01541), (TENDON_END, 0.00642), (LENGTH, 0.00480))
"""Distance from the base and radius [m] of the section, linear in between."""
TENDON_ANGLES = (np.deg2rad(30.0), np.deg2rad(150.0))
"""Angles [rad] of the tendons around the axis, from n towards b."""
TENDON_RADIUS, TENDON_TAPER = 0.0114, -0.0295
"""Distance [m] of the tendons from the axis at the base, and its change along the arm."""
MARKER_S = (0.1291, 0.2195, 0.2800, 0.3600)
"""Distances [m] of the markers from the base."""
MARKER_OFFSETS = ((0.0, 0.0, 0.025), (0.0, 0.0, -0.021), (0.0, 0.0, 0.020), (0.008, 0.0, 0.0))
"""Places (t, n, b) [m] of the markers relative to the axis."""
CLAMP = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))
"""Frame at the base, with t, n and b as columns: the arm hangs along -z."""
EDGES = np.concatenate(
    [
        np.linspace(begin, end, cells, endpoint=False)
        for begin, end, cells in zip(
            (0.0, *MARKER_S[:3], TENDON_END), (*MARKER_S[:3], TENDON_END, LENGTH), (4, 3, 2, 1, 2),
            strict=True,
        )
    ]
    + [[LENGTH]]
)  # fmt: skip
"""Ends [m] of the cells. The markers and the end of the tendons are among them."""
POINTS = 2 * (len(EDGES) - 1)
"""Number of points with strains, two in each cell."""
MARKER_NODES = np.searchsorted(EDGES, np.array(MARKER_S) - 1e-9)
"""Numbers of the nodes at the markers."""
INCREMENTS = 8
"""Number of load increments from the unloaded arm."""
POISSON = 0.45
"""Poisson's ratio. Two tendons hardly twist the arm, so the markers do not determine it."""


class ArmParameters(NamedTuple):
    """The parameters of the arm."""

    E: Array | float = 5.05e5
    """Young's modulus [Pa]."""
    density: Array | float = 1500.0
    """Density [kg/m^3]."""


class ArmParts(eqx.Module):
    """Parts of the arm that an effect may change."""

    rod: Rod
    tendons: tuple[RodTendon, ...]
    offsets: Float[Array, "4 3"]
    """Places (t, n, b) [m] of the markers relative to the axis."""
    base: Float[Array, "3"]
    """Position (x, y, z) [m] of the base, relative to its stated place."""
    strains: Float[Array, "points 4"]
    """Latest known strains, for effects that depend on the shape."""


class ArmShape(NamedTuple):
    """Shape of the arm under given tensions."""

    markers: Float[Array, "4 3"]
    """Positions (x, y, z) [m] of the markers."""
    strains: Float[Array, "points 4"]
    ok: Bool[Array, ""]


def rod_of(parameters: ArmParameters) -> Rod:
    """Returns the arm as a rod, with the properties of its circular sections."""
    places, radii = np.array(RADII).T
    radius = np.interp(gauss_points(EDGES), places, radii)
    E, shear = parameters.E, parameters.E / (2.0 * (1.0 + POISSON))
    EI = E * np.pi * radius**4 / 4.0
    return Rod(
        ds=jnp.asarray(np.diff(half_cells(EDGES))),
        stiffness=jnp.stack([shear * np.pi * radius**4 / 2.0, EI, EI], axis=1),
        initial_curvature=jnp.zeros((len(radius), 3)),
        clamp=jnp.array(CLAMP),
        weight=parameters.density * G * np.pi * radius**2,
        EA=E * np.pi * radius**2,
    )


def arm_tendons(tensions: Float[Array, "2"]) -> tuple[RodTendon, ...]:
    """Returns both tendons with the given tensions [N]."""
    near, far = TENDON_RADIUS, TENDON_RADIUS + TENDON_TAPER * TENDON_END
    sides = [np.array([np.cos(angle), np.sin(angle)]) for angle in TENDON_ANGLES]
    return tuple(
        straight_tendon((0.0, TENDON_END), near * side, far * side, tension, EDGES)
        for side, tension in zip(sides, tensions, strict=True)
    )


def arm_parts(
    parameters: ArmParameters, tensions: Float[Array, "2"], strains: Float[Array, "points 4"]
) -> ArmParts:
    """Returns the parts of the arm as stated, under two tensions [N]."""
    rod, tendons = rod_of(parameters), arm_tendons(tensions)
    return ArmParts(rod, tendons, jnp.array(MARKER_OFFSETS), jnp.zeros(3), strains)


def arm_shape(
    parts: ArmParts, increments: int, start: Float[Array, "points 4"] | None = None
) -> ArmShape:
    """Returns the shape under tensions and weight.

    `start` are the strains of a similar arm (default: the unloaded arm).
    """
    none = jnp.zeros(3)
    loads = RodLoads(none, none, jnp.array([0.0, 0.0, -1.0]), parts.tendons)
    found = equilibrium(parts.rod, loads, increments, start)
    return ArmShape(_markers(found, parts.offsets) + parts.base, found.strains, found.ok)


def _markers(found: RodEquilibrium, offsets: Float[Array, "4 3"]) -> Float[Array, "4 3"]:
    turned = jnp.einsum("kij,kj->ki", found.shape.frame[MARKER_NODES], offsets)
    return found.shape.position[MARKER_NODES] + turned
