"""Tests of weight and buoyancy: the sag of a clamped, submerged beam in a vertical plane."""

import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.dynamics.statics import Loads
from slider_jax.experiment.load import load, to_model, to_numerics
from tests.support.experiments import refusal_of, write_small_experiment
from tests.support.helpers import static_state

M, L, EI, G, WATER = 0.7, 0.37, 3.8, 9.81, 1000.0
VERTICAL = '[[effects]]\nname = "gravity"\ng = 9.81\nup = 1.5707963267948966\n\n'
SEGMENTS = """
[[robot.segments]]
length = 0.3
linear_density = 0.7
EI = 3.8
density = 1100.0

[[robot.segments]]
part = "tail"
length = 0.07
linear_density = 0.4
EI = 3.8
"""


def experiment(folder, *changes):
    """The small experiment with a stiff body that moves in a vertical plane; 51 nodes."""
    stiff = ("EI_body = 0.038\nEI_tail = 0.0058", f"EI_body = {EI}\nEI_tail = {EI}")
    fine, gravity = ("nodes = 11", "nodes = 51"), ("[[trials]]", f"{VERTICAL}[[trials]]")
    return write_small_experiment(folder, stiff, fine, gravity, *changes)


def segmented(folder, segments):
    keys = "body_length = 0.3\ntail_length = 0.07\nlinear_density = 0.7\nEI_body = 0.038\n"
    own = (f"{keys}EI_tail = 0.0058\n", ""), ("\n[parameters]", f"{segments}\n[parameters]")
    tables = ("[[trials]]", f"{VERTICAL}[[trials]]")
    return write_small_experiment(folder, *own, ("nodes = 11", "nodes = 51"), tables)


def at_rest(path):
    each = load(path)
    loads = Loads(jnp.zeros(2), jnp.zeros(2))
    return static_state(to_model(each), loads, to_numerics(each)[0])


@pytest.mark.slow
def test_a_submerged_beam_sags_by_its_net_weight(tmp_path):
    """w L^4/(8 EI) with w = (rho_s - rho) A g; without the density, the whole weight acts."""
    dense = ("height = 0.03", "height = 0.03\ndensity = 1100.0")
    for changes, net in (((dense,), M * (1.0 - WATER / 1100.0)), ((), M)):
        found = at_rest(experiment(tmp_path, *changes))
        sag = net * G * L**4 / (8.0 * EI)
        assert found.ok and sag < 0.02 * L
        np.testing.assert_allclose(found.shape[1, 0], -sag, rtol=1e-3)


@pytest.mark.slow
def test_a_neutrally_buoyant_robot_does_not_sag(tmp_path):
    found = at_rest(experiment(tmp_path, ("height = 0.03", "height = 0.03\ndensity = 1000.0")))
    np.testing.assert_allclose(found.shape[1], 0.0, atol=1e-15)


@pytest.mark.slow
def test_each_segment_has_its_own_buoyancy(tmp_path):
    """The clamp carries the net weight; the tail floats."""
    text = SEGMENTS.replace('part = "tail"', 'part = "tail"\ndensity = 900.0')
    found = at_rest(segmented(tmp_path, text))
    net = G * (0.3 * 0.7 * (1.0 - WATER / 1100.0) + 0.07 * 0.4 * (1.0 - WATER / 900.0))
    np.testing.assert_allclose(abs(float(found.y[1, -1])), net, rtol=1e-3)


def test_a_robot_has_a_density_everywhere_or_nowhere(tmp_path):
    message = "robot.segments.1.density: given nothing; allowed a number here or in [robot]"
    assert message in refusal_of(segmented(tmp_path, SEGMENTS))


@pytest.mark.parametrize("angle", [0.0, 0.6])
def test_the_weight_is_opposite_to_the_upward_direction(tmp_path, angle):
    """The clamp carries the whole weight m g L, along and across the straight stiff beam."""
    path = experiment(tmp_path, ("up = 1.5707963267948966", f"up = {angle}"))
    y = at_rest(path).y[:, -1]
    weight = M * G * L
    np.testing.assert_allclose(abs(y[0]), weight * np.cos(angle), rtol=1e-3)
    np.testing.assert_allclose(abs(y[1]), weight * np.sin(angle), rtol=1e-3, atol=1e-12)
