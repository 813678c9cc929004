"""The search on models whose answer is known: sums of a few series."""

from types import SimpleNamespace

import numpy as np
import pytest

from calibration.discrepancy.selection import search
from calibration.inference.problem import ChannelBlock
from calibration.model.extended import Parameter
from slider_jax.effects import Prior

TRIALS, SAMPLES = 4, 300
NAMES = ("regulator_gain", "carried_mass", "tank_current", "force_gain")
"""Those of effects that exclude none; what they do here is `SHAPES`."""
ENTRIES = [Parameter("", "k", Prior(np.nan, -50.0, 50.0, "-", ""))] + [
    Parameter(name, "x", Prior(0.0, -50.0, 50.0, "-", "")) for name in NAMES
]
rng = np.random.default_rng(1)
SHAPES = rng.normal(size=(5, TRIALS, SAMPLES))
# The second effect is the fourth one and something of the third: a wrong one that explains more
# than either while both are missing.
SHAPES[2] = SHAPES[4] + 0.25 * SHAPES[3] + 0.1 * SHAPES[2]


class Sums:
    """Readings are sums of shapes (parameters, trials, samples), and noise."""

    channels = ("tip",)
    maps = memo = None

    def __init__(self, truth, shapes=SHAPES, noise=0.1, seed=0):
        self.shapes, self.size = shapes, 1.0 / noise
        noise = np.random.default_rng(seed).normal(size=(TRIALS, SAMPLES))
        self.y = self._sum(np.asarray(truth)) + noise
        self.records = [
            SimpleNamespace(values=np.zeros((5, SAMPLES)), trial=SimpleNamespace(file=str(i)))
            for i in range(TRIALS)
        ]

    def _sum(self, theta):
        return self.size * np.tensordot(theta, self.shapes, 1)

    def predict(self, theta):
        found = np.zeros((TRIALS, 5, SAMPLES))
        found[:, 4] = self._sum(theta)
        return list(found)

    def tangents(self, theta, directions):
        found = np.zeros((TRIALS, len(directions), 5, SAMPLES))
        found[:, :, 4] = self.size * np.einsum("kp,pts->tks", directions, self.shapes)
        return list(found)

    def whiteners(self, predicted):
        return {}

    def residuals(self, predicted, white):
        return {(i, "tip"): self.y[i] - predicted[i][4] for i in range(TRIALS)}

    def blocks(self, residuals, derivatives, white):
        found = []
        for (i, channel), r in residuals.items():
            J = derivatives[i][:, 4]
            found.append(ChannelBlock(i, channel, J @ J.T, J @ r, float(r @ r), len(r)))
        return found


def searched(truth):
    return search(Sums(truth), ENTRIES, np.zeros(5), base_names=("k",))


@pytest.mark.parametrize(
    ("truth", "effects"),
    [
        ((1.0, 0.0, 0.0, 0.0, 0.0), []),
        ((1.0, 0.5, 0.0, 0.0, 0.0), ["regulator_gain"]),
        ((1.0, 0.5, 0.0, 0.3, 0.0), ["regulator_gain", "tank_current"]),
    ],
)
def test_what_is_there_is_found_and_nothing_else(truth, effects):
    found = searched(truth)
    assert found.effects == effects
    np.testing.assert_allclose(found.final.theta, truth, atol=0.02)


def test_a_wrong_effect_that_came_first_is_taken_out_again():
    truth = (1.0, 0.0, 0.0, 0.4, 1.0)
    found = searched(truth)
    assert found.rounds[0].taken_out == "carried_mass" and found.rounds[0].chosen is None
    assert set(found.effects) == {"tank_current", "force_gain"}
    np.testing.assert_allclose(found.final.theta, truth, atol=0.02)
    assert found.final.theta[2] == 0.0 and 2 not in found.final.free
    assert not any(r.alike for r in found.rounds)


def test_an_effect_that_is_still_needed_stays():
    truth = (1.0, 0.0, 0.5, 0.4, 1.0)
    found = searched(truth)
    assert set(found.effects) == {"carried_mass", "tank_current", "force_gain"}
    assert not any(r.taken_out for r in found.rounds)
