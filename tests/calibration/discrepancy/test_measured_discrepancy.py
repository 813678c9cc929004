"""The measured discrepancy in the selection, on a tank whose readings have a closed form.

Each effect adds a tone to the thrust; the effects' physical meaning is not used.
"""

import numpy as np
import pytest

from calibration.discrepancy.selection import select_effects
from calibration.inference.problem import TankProblem
from calibration.model.extended import BASE, base_vector, model_parameters
from calibration.model.predict import Resolution
from slider_jax.channels import CHANNELS
from tests.support import closed_form_tank as tank

NAMES = ("carried_mass", "valve_delay")
ENTRIES = model_parameters(NAMES)
THETA = (3.0, 0.7, 0.08, 4.5e-7)
FINER = Resolution(21, 40, 5e-3)
FREQUENCIES = (1.0, 1.6, 2.2, 2.9, 3.7)


@pytest.fixture(autouse=True)
def closed_form(monkeypatch):
    tank.replace_the_beam(monkeypatch)


def selection(size, fine=FINER, declared=None):
    """Returns the selection for a tone of the given size, and the text of its progress."""
    experiment, lines = tank.experiment_of(FREQUENCIES), []
    if declared is not None:
        experiment = experiment.with_values({"sensors.thrust_discrepancy": declared})
    theta = np.array([*THETA, size, 0.0])
    records = tank.measured(experiment, [theta] * len(FREQUENCIES), 1)
    problem = TankProblem.of(experiment, records, NAMES, fine=fine, coarse=tank.MESH)
    start = base_vector(ENTRIES, dict(zip(BASE, THETA, strict=True)))
    return select_effects(problem, ENTRIES, start, lines.append), lines


def test_an_effect_below_the_constant_is_found_in_data_without_another_error():
    """The effect changes the thrust by 1 %. The constant discrepancy is 7 %."""
    found, lines = selection(0.02)
    assert found.effects == ["carried_mass"]
    assert found.final.theta[len(BASE)] == pytest.approx(0.02, rel=0.15)
    sizes = found.rounds[0].refitted[0].sizes
    assert found.discrepancies["thrust"] < 0.005 < sizes["thrust"] < 0.02
    assert sum("measured model-discretisation discrepancy" in x for x in lines) in (1, 2)
    assert found.measured["thrust"].used <= found.discrepancies["thrust"]


def test_without_a_second_mesh_the_constants_apply():
    found, _ = selection(0.02, fine=tank.MESH)
    assert not found.effects and not found.measured
    assert found.discrepancies == {c: x.discrepancy for c, x in CHANNELS.items()}


def test_a_declared_discrepancy_hides_a_smaller_effect():
    found, _ = selection(0.02, declared=0.03)
    assert not found.effects and found.discrepancies["thrust"] == 0.03
