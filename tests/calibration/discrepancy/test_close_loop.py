"""The loop on simulated tanks with known effects, few candidates and a coarse mesh."""

import json
from pathlib import Path

import numpy as np
import pytest

from calibration.discrepancy.close_loop import close_loop_on_trials
from calibration.discrepancy.page import loop_page
from calibration.discrepancy.report import (
    error_lines,
    loop_model_toml,
    loop_record,
    parameter_lines,
)
from calibration.inference.gauss_newton import GAIN_TOLERANCE
from calibration.measurements.synthetic import Truth, write_tank
from slider_jax.errors import InputError
from slider_jax.experiment.load import load
from slider_jax.io.files import LOADED_FILES
from tests.support.damage import RUNS as DAMAGE_RUNS, write_experiment
from tests.support.small_tank import (
    BASE,
    CANDIDATES,
    MESH,
    NULLS,
    OF_ONE_BODY,
    RUNS,
    TANK,
    close_small_tank,
)

SOURCE = {"path": "tank.toml", "sha256": 4 * "abcdef"}


@pytest.fixture(scope="module")
def null(tmp_path_factory):
    return close_small_tank(tmp_path_factory.mktemp("null"), {})


@pytest.fixture(scope="module")
def delayed(tmp_path_factory):
    """Tested by default: one program of robot and water serves all fits."""
    folder = tmp_path_factory.mktemp("delayed")
    return close_small_tank(folder, {"valve_delay": {"delay": 0.02}}, 1, OF_ONE_BODY)


def covers(outcome, name, truth):
    index = next(i for i, p in enumerate(outcome.entries) if p.label == name)
    _, low, high = outcome.interval(index)
    return low < truth < high


@pytest.mark.slow
def test_no_effect_is_named_if_the_model_is_complete(null):
    assert (null.verdict, null.search.effects) == ("nothing_missing", [])
    for name, value in BASE.items():
        assert covers(null, name, value), name


def test_the_missing_effect_is_named_with_its_size(delayed):
    assert (delayed.verdict, delayed.search.effects) == ("identified", ["valve_delay"])
    assert covers(delayed, "valve_delay.delay", 0.02)
    for name, value in BASE.items():
        assert covers(delayed, name, value), name


def test_held_out_trials_are_predicted_at_the_noise_floor(delayed):
    assert all(x["after"] < 1.3 * x["floor"] for x in delayed.held_out.values())
    assert delayed.held_out["p_front"]["before"] > 5 * delayed.held_out["p_front"]["after"]


def test_the_report_is_complete_and_the_model_file_loads(delayed, tmp_path, monkeypatch):
    monkeypatch.setitem(LOADED_FILES, Path("wall.py"), 4 * "123456")
    record = json.loads(json.dumps(loop_record(delayed, 1.0, SOURCE), default=float))
    assert record["verdict"] == "identified" and record["effects"][0]["name"] == "valve_delay"
    assert set(record["parameters"]) == {"C_d", "m_a", "k", "K_Q"}
    k = record["parameters"]["k"]
    assert k["given"] == delayed.experiment.parameters.k
    assert k["without_effects"] > k["high"]  # without the effect, the lag compensates for the delay
    assert max(record["left_over_noise"].values()) < 1.1
    assert record["errors"]["p_front"]["after"] < 0.2 * record["errors"]["p_front"]["before"]
    assert {row["name"] for row in record["candidates"]} == set(OF_ONE_BODY)
    html = loop_page(delayed, record)
    assert html.count("data:image/png") == 2 and "valve_delay" in html
    assert "Verdict: identified. Data: tank.toml (sha256 abcdefabcdef)" in html
    assert record["effect_files"] == [{"path": "wall.py", "sha256": 4 * "123456"}]
    assert "Effect files: wall.py (sha256 123456123456)" in html
    (line,) = parameter_lines(record)
    assert line.startswith("valve_delay.delay = 0.0") and line.endswith(") s")
    assert error_lines(record)[0].startswith("p_front, held-out trials: rms ")
    refitted = [x for x in record["candidates"] if "explained" in x]
    assert html.count(">chosen<") == 1 and html.count("<td>1: ") == len(refitted) > 0
    assert "without the effects" in html and "above it" not in html
    assert record["audit"] == [] and "No fault was found in the data" in html
    (tmp_path / "model.toml").write_text(loop_model_toml(delayed))
    file = delayed.experiment.folder / "experiment.toml"
    again = load(file, tmp_path / "model.toml")
    assert again.effects[0].name == "valve_delay"
    np.testing.assert_allclose(again.parameters.k, delayed.final.theta[2], rtol=1e-8)


@pytest.mark.slow
def test_the_verdict_does_not_depend_on_noise_or_order_of_the_trials(delayed, tmp_path):
    truth = Truth(BASE, {"valve_delay": {"delay": 0.02}})
    reversed_tank = write_tank(tmp_path / "reversed", truth, RUNS, 1, numerics=TANK)
    head, *tables = reversed_tank.read_text().split("[[trials]]")
    reversed_tank.write_text("[[trials]]".join([head, *(x + "\n" for x in reversed(tables))]))
    again = close_loop_on_trials(load(reversed_tank), CANDIDATES, fine=MESH, coarse=MESH)
    assert (again.verdict, again.search.effects) == (delayed.verdict, delayed.search.effects)
    for i in delayed.final.free:
        _, low, high = delayed.interval(int(i))
        off = again.final.theta[i] - delayed.final.theta[i]
        tolerance = np.sqrt(GAIN_TOLERANCE) * (high - low) / 3.92
        assert abs(off) <= 2.0 * tolerance  # each of the two fits may be off by its tolerance
    for seed in (5, 6):
        other = close_small_tank(tmp_path / f"seed_{seed}", truth.effects, seed)
        assert (other.verdict, other.search.effects) == ("identified", ["valve_delay"])


@pytest.mark.slow
def test_a_residual_that_no_candidate_explains_is_unexplained(tmp_path):
    outcome = close_small_tank(tmp_path / "odd", {"stiffening": {"beta": 5e-4}}, 2)
    assert outcome.verdict == "unexplained"
    record = loop_record(outcome, 1.0, {})
    assert record["effects"] == [] and "[[effects]]" not in loop_model_toml(outcome)
    assert record["residual"]["status"] == "above_floor" and record["unexplained"]
    assert all(x["after"] == x["before"] for x in outcome.used.values())


@pytest.mark.slow
def test_wrong_declared_noise_keeps_the_verdict_and_a_hum_is_reported(tmp_path):
    """All declared noises are 25 % too small. The hum has the amplitude of the white noise."""
    path = write_tank(tmp_path, Truth(BASE, NULLS), RUNS, 3, numerics=TANK)
    text = path.read_text()
    for right in ("pressure_noise = 700.0", "force_noise = 0.02", "tip_noise = 0.0005"):
        assert right in text
        key, value = right.split(" = ")
        text = text.replace(right, f"{key} = {0.75 * float(value)}")
    path.write_text(text)
    found = close_loop_on_trials(load(path), CANDIDATES, fine=MESH, coarse=MESH)
    assert found.verdict == "nothing_missing" and found.noise["thrust"].replaced
    for file in tmp_path.glob("*.csv"):
        head, *rows = [line.split(",") for line in file.read_text().splitlines()]
        thrust = head.index("thrust_N")
        for row in rows:
            hum = 0.02 * np.sin(2.0 * np.pi * 13.0 * float(row[0]) + 1.0)
            row[thrust] = f"{float(row[thrust]) + hum:.6f}"
        file.write_text("\n".join(",".join(row) for row in [head, *rows]) + "\n")
    found = close_loop_on_trials(load(path), CANDIDATES, fine=MESH, coarse=MESH)
    assert found.verdict == "unexplained"
    patterns = [x for x in found.excess["thrust"].patterns if x.has_line]
    assert len(patterns) >= 3
    for x in patterns:
        assert x.frequency_Hz == pytest.approx(13.0, abs=0.3)
        assert x.amplitude == pytest.approx(0.02, rel=0.3)


@pytest.mark.slow
def test_an_effect_with_another_shape_is_identified_with_its_shape(tmp_path):
    """The default of kappa_c is 0.3. With this value, other effects would explain the data."""
    truth = Truth(BASE, NULLS | {"internal_friction": {"z_c": 0.015, "kappa_c": 1.0}})
    names = "internal_friction", "material_damping", "stress_relaxation", "body_stiffness"
    path = write_tank(tmp_path / "friction", truth, RUNS, 1, numerics=TANK)
    outcome = close_loop_on_trials(load(path), names, fine=MESH, coarse=MESH)
    assert (outcome.verdict, outcome.effects) == ("identified", ["internal_friction"])
    assert covers(outcome, "internal_friction.kappa_c", 1.0)
    record = json.loads(json.dumps(loop_record(outcome, 1.0, SOURCE), default=float))
    (effect,) = record["effects"]
    shape = effect["parameters"]["kappa_c"]
    assert shape["high"] - shape["low"] < 0.2 and effect["segments"] == ["body"]
    assert "<td>internal_friction.kappa_c</td>" in loop_page(outcome, record)
    (tmp_path / "model.toml").write_text(loop_model_toml(outcome))
    (again,) = load(path, tmp_path / "model.toml").effects
    assert again.kappa_c == pytest.approx(shape["value"], rel=1e-6)


def test_too_few_trials_are_refused(tmp_path):
    path = write_experiment(tmp_path / "two", runs=DAMAGE_RUNS[:2])
    with pytest.raises(InputError, match="2 measured trials are usable"):
        close_loop_on_trials(load(path), ())
