"""Tests of the wet fraction of cells against the geometry of straight and curved bodies."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.beam.waterline import Waterline

NODES = 41
LENGTH = 0.37


def straight(angle, head, nodes=NODES):
    """Nodes (x, y) of a straight body at `angle`, with its head at the height `head`; x is up."""
    s = jnp.linspace(-LENGTH, 0.0, nodes)
    return jnp.stack([head + s * jnp.cos(angle), s * jnp.sin(angle)])


def wet_length(waterline, nodes):
    return float(jnp.sum(waterline.immersion(nodes).wet) * LENGTH / (nodes.shape[1] - 1))


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.2, np.pi, 2.5])
@pytest.mark.parametrize("thickness", [1e-3, 0.03, 0.08])
def test_the_wet_length_of_a_body_that_pierces_the_surface_is_exact(angle, thickness):
    """The length below the surface, for every thickness, on a coarse mesh, head up or down."""
    waterline = Waterline(0.1, 0.0, thickness)
    for share in (0.5, 0.37):
        head = 0.1 + share * LENGTH * np.cos(angle)
        below = 1.0 - share if np.cos(angle) > 0.0 else share
        for nodes in (4, NODES):
            wet = wet_length(waterline, straight(angle, head, nodes))
            np.testing.assert_allclose(wet, below * LENGTH, rtol=1e-12)


def test_a_level_body_is_wet_by_the_fraction_of_its_thickness():
    """1/2 + 3 x/2 - 2 x^3 at the depth x, in thicknesses; 0 above, and 1 below."""
    waterline = Waterline(0.0, jnp.pi / 2, 0.02)
    for x in (-0.6, -0.5, -0.3, 0.0, 0.2, 0.5, 3.0):
        nodes = jnp.stack([jnp.linspace(0.0, 1.0, 5), jnp.full(5, -0.02 * x)])
        expected = 0.5 + 1.5 * np.clip(x, -0.5, 0.5) - 2.0 * np.clip(x, -0.5, 0.5) ** 3
        np.testing.assert_allclose(waterline.immersion(nodes).wet, expected, atol=1e-14)


def test_wet_fraction_and_its_derivatives_are_smooth_where_the_formula_changes():
    """Close to the level cell, the quotient and Simpson's rule agree, and so do gradients."""
    waterline = Waterline(0.0, 0.0, 0.03)

    def wet(place, tilt):
        nodes = jnp.array([[place, place + 0.03 * tilt], [0.0, 0.01]])
        return waterline.immersion(nodes).wet[0]

    for place in (-0.01, 0.0, 0.0149, -0.015):
        a, b = (jax.grad(wet, (0, 1))(place, tilt) for tilt in (0.99e-4, 1.01e-4))
        np.testing.assert_allclose(a, b, rtol=1e-4, atol=5e-4)
        np.testing.assert_allclose(wet(place, 0.99e-4), wet(place, 1.01e-4), atol=1e-5)


def test_slope_is_the_derivative_of_the_wet_fraction_and_moving_sideways_wets_nothing():
    waterline = Waterline(0.02, 0.3, 0.03)
    nodes = straight(0.9, 0.1)
    up, step = waterline.upward(), 1e-6
    found = waterline.immersion(nodes)
    lower, upper = (waterline.immersion(nodes + d * up[:, None]).wet for d in (-step, step))
    np.testing.assert_allclose(found.slope, (lower - upper) / (2.0 * step), atol=1e-6)
    # A velocity across the body of 1 m/s moves the body along n = (-sin, cos).
    n = jnp.array([-jnp.sin(0.9), jnp.cos(0.9)])
    ahead, behind = (waterline.immersion(nodes + d * n[:, None]).wet for d in (step, -step))
    rate = found.wetting(jnp.ones(NODES - 1), jnp.full(NODES - 1, 0.9))
    assert float(jnp.abs(rate).max()) > 1.0
    np.testing.assert_allclose(rate, (ahead - behind) / (2.0 * step), atol=1e-6)
