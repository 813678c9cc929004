"""Hinge angles from markers, also where the tracker lost markers of the tail."""

import numpy as np
import pytest

from calibration.robot_fish.fish import HINGES, MARKER_X
from calibration.robot_fish.hinges import ARMS, LOADED, PULLED, hinge_angles
from calibration.robot_fish.markers import MarkerRun

BEAT, NOISE = 0.75, 0.5e-3
RATIO = -0.9 - 1.1j


def moving_tail(pulled=0.9 * np.exp(0.3j), off=1.0, seed=0):
    """Returns markers of a fish whose hinges bend in M_1 and M_2, and the true hinge angles."""
    t = np.arange(301) / 60.0
    true = pulled * (PULLED + off * RATIO * LOADED)
    angles = np.real(true * np.exp(2j * np.pi * BEAT * t)[:, None])
    # The fish looks along +x, so the tail points along -x, and left is +y.
    heading = np.cumsum(angles, axis=1)
    ends = np.concatenate([HINGES, [0.5]])
    markers = np.zeros((len(t), 9, 2))
    place = np.stack([np.full(len(t), -HINGES[0]), np.zeros(len(t))], axis=1)
    for k, x in enumerate(MARKER_X):
        if x < HINGES[0]:
            markers[:, k] = [-x, 0.0]
    for i in range(5):
        ahead = np.stack([-np.cos(heading[:, i]), np.sin(heading[:, i])], axis=1)
        for k, x in enumerate(MARKER_X):
            if ends[i] <= x < ends[i + 1]:
                markers[:, k] = place + (x - ends[i]) * ahead
        place = place + (ends[i + 1] - ends[i]) * ahead
    markers += NOISE * np.random.default_rng(seed).standard_normal(markers.shape)
    return MarkerRun("a", BEAT, t, markers), true


def error(found, true):
    """Largest error of a hinge angle, relative to the sum of the angles."""
    return np.abs(found - true).max() / np.abs(np.sum(true))


def test_pulled_shape_changes_the_tendons_and_loaded_shape_does_not():
    assert ARMS @ PULLED == pytest.approx(0.0345)
    assert ARMS @ LOADED == pytest.approx(0.0, abs=1e-12)


def test_hinge_angles_of_a_known_tail():
    """Tolerance: 4 % with noise of 0.5 mm."""
    run, true = moving_tail()
    assert error(hinge_angles(run), true) < 0.04


def test_lost_markers_hardly_change_the_hinge_angles():
    """Tolerance: 6 % if markers 5 and 6 stay at places of their neighbours."""
    run, true = moving_tail()
    markers = run.markers.copy()
    markers[40:140, 6] = markers[40:140, 4]
    markers[100:220, 5] = markers[100:220, 3]
    markers[:, 3] += 0.05
    lost = MarkerRun("a", BEAT, run.t, markers)
    assert error(hinge_angles(lost), true) < 0.06
