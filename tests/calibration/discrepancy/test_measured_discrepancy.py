"""The measured discrepancy in the selection, on a tank whose readings have a closed form.

Each effect adds a tone to the thrust; the effects' physical meaning is not used.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calibration.discrepancy.close_loop import conclude
from calibration.discrepancy.page import loop_page
from calibration.discrepancy.report import discrepancy_sentences, loop_record
from calibration.discrepancy.selection import select_effects
from calibration.inference.measured_discrepancy import Discrepancy
from calibration.inference.problem import TankProblem
from calibration.model.extended import BASE, base_values, base_vector, model_parameters
from calibration.model.plan import Resolution
from slider_jax.channels import SLIDER_CHANNELS
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
    assert found.discrepancies["p_front"] == SLIDER_CHANNELS["p_front"].discrepancy


def test_without_a_second_mesh_the_constants_apply():
    found, _ = selection(0.02, fine=tank.MESH)
    assert not found.effects and not found.measured
    assert found.discrepancies == {c: x.discrepancy for c, x in SLIDER_CHANNELS.items()}


def test_a_declared_discrepancy_hides_a_smaller_effect():
    found, _ = selection(0.02, declared=0.03)
    assert not found.effects and found.discrepancies["thrust"] == 0.03


def repeating_curve(t, f, rng):
    """Returns a periodic curve of unit rms with the spectrum of a correlation time of 20 ms."""
    omega = 2.0 * np.pi * f * np.arange(1, 16)[:, None]
    a, b = rng.normal(size=(2, 15)) / np.sqrt(1.0 + (0.02 * omega[:, 0]) ** 2)
    curve = a @ np.cos(omega * t) + b @ np.sin(omega * t)
    return curve / np.std(curve)


def report(share):
    """Returns report.json and the page for data with a repeating error of the thrust."""
    experiment = tank.experiment_of(FREQUENCIES)
    records = tank.measured(experiment, [np.array([*THETA, 0.0, 0.0])] * len(FREQUENCIES), 2)
    row, rng = SLIDER_CHANNELS.row("thrust"), np.random.default_rng(3)
    for i, r in enumerate(records):
        values, error = r.values.copy(), repeating_curve(r.t, FREQUENCIES[i], rng)
        values[row] += share * np.std(values[row]) * error
        records[i] = replace(r, values=values)
    outcome = conclude(
        experiment,
        NAMES,
        records,
        [2],
        lambda chosen: TankProblem.of(
            experiment, list(chosen), NAMES, fine=FINER, coarse=tank.MESH
        ),
        base_values(experiment),
        tuple(BASE),
        lambda text: None,
    )
    record = loop_record(outcome, 1.0, {"path": "a", "sha256": "0"})
    assert outcome.problem.discrepancies == outcome.search.discrepancies
    return record, loop_page(outcome, record)


def test_a_repeating_error_is_reported_and_is_no_missing_effect():
    record, page = report(0.03)
    thrust = record["discrepancy"]["thrust"]
    assert record["verdict"] == "nothing_missing"
    assert thrust["measured"] == pytest.approx(0.03, rel=0.25)
    assert thrust["lower_limit"] < 1e-9 and thrust["used"] < 0.05 and thrust["declared"] is None
    sentence = f"repeatable error of {100.0 * thrust['measured']:.2g} % of the thrust"
    assert sentence in record["said"] and sentence in page
    assert f"<td>{100.0 * thrust['used']:.2g} %</td>" in page


@pytest.mark.parametrize(
    ("measured", "used", "declared", "stated"),
    [
        (0.03, 0.034, None, True),
        (0.013, 0.023, None, False),  # 1.3 % with a standard error of 1 %
        (0.013, 0.013, 0.013, True),
        (0.005, 0.0051, None, False),  # not above the model's own error
    ],
)
def test_a_repeating_error_within_its_own_error_is_not_stated(measured, used, declared, stated):
    found = {"thrust": Discrepancy(declared, 0.004, measured, used)}
    problem = SimpleNamespace(all_channels=SLIDER_CHANNELS)
    outcome = SimpleNamespace(search=SimpleNamespace(measured=found), problem=problem)
    assert bool(discrepancy_sentences(outcome)) == stated
