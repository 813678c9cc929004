"""`slider calibrate`: parameters of a simulated tank, from the command line."""

import json
import tomllib
from types import SimpleNamespace

import numpy as np
import pytest

from calibration.identification import identify
from calibration.inference.goodness import Excess
from calibration.inference.problem import TankProblem
from calibration.measurements.synthetic import Truth, random_trials, write_tank
from calibration.model.plan import Resolution
from slider_jax.cli.main import main
from tests.support import closed_form_tank

TRUTH = {"C_d": 3.0, "m_a": 0.8, "k": 0.075, "K_Q": 4.5e-7}
COARSE_TANK = {"nodes": 13, "step": 2e-3, "scheme": "sdirk2"}
MESH = Resolution(13, 40, 4.0e-3)


@pytest.fixture(scope="module")
def tank(tmp_path_factory):
    runs = [run | {"duration": 1.0} for run in random_trials(5, count=5)[2:]]
    folder = tmp_path_factory.mktemp("tank")
    truth = Truth(TRUTH, {"tangential_friction": {"C_t": 0.1}})
    return write_tank(folder, truth, runs, 0, numerics=COARSE_TANK)


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    of = TankProblem.of
    monkeypatch.setattr(
        identify.TankProblem, "of", lambda e, r, n, c, fine, coarse: of(e, r, n, c, MESH, MESH)
    )


@pytest.mark.slow
def test_the_intervals_contain_the_truth_also_of_an_added_effect(tank, tmp_path, capsys):
    out = tmp_path / "out"
    arguments = ["calibrate", str(tank), "--out", str(out), "--also", "tangential_friction"]
    assert main(arguments) == 0
    found = json.loads((out / "calibration.json").read_text())
    truth = TRUTH | {"tangential_friction.C_t": 0.1}
    assert set(found["parameters"]) == set(truth)
    for name, value in truth.items():
        x = found["parameters"][name]
        assert x["low"] < value < x["high"], name
    assert found["converged"] and 0.8 < found["mean_square_over_noise"] < 1.3
    for channel in found["errors"].values():
        assert channel["after"] < 1.3 * channel["floor"]
    matrix = found["correlations"]["matrix"]
    assert [row[i] for i, row in enumerate(matrix)] == pytest.approx([1.0] * 5)
    assert "tangential_friction" in (out / "model.toml").read_text()
    assert "C_d" in capsys.readouterr().out


@pytest.mark.slow
def test_damaged_trials_are_repaired_and_reported(tank, tmp_path):
    for file in tank.parent.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    names = sorted(x.name for x in tmp_path.glob("trial_*.csv"))
    first = tmp_path / names[0]
    lines = first.read_text().splitlines()
    first.write_text("\n".join([*lines[:100], *lines[160:-1], lines[-1][:9]]))
    second = tmp_path / names[1]
    rows = [x.split(",") for x in second.read_text().splitlines()]
    for row in rows[1:]:
        row[3] = f"{1e3 * float(row[3]):.6g}"
    second.write_text("\n".join(map(",".join, rows)))
    arguments = ["calibrate", str(tmp_path / "experiment.toml"), "--out", str(tmp_path / "out")]
    assert main([*arguments, "--also", "tangential_friction"]) == 0
    found = json.loads((tmp_path / "out" / "calibration.json").read_text())
    assert [(x["trial"], x["kind"], x["action"]) for x in found["audit"]] == [
        (names[0], "torn_line", "masked"), (names[0], "gap", "used"), (names[1], "units", "mended")
    ]  # fmt: skip
    assert found["trials"] == names
    for channel in found["errors"].values():
        assert channel["after"] < 1.3 * channel["floor"]


@pytest.mark.parametrize(("square", "warns"), [(1.2, False), (9.0, True)])
def test_a_residual_above_the_noise_floor_gives_a_warning(monkeypatch, square, warns):
    left = {"thrust": Excess(np.ones(2), 1.0), "tip": Excess(np.full(2, square), square)}
    monkeypatch.setattr(identify, "excess", lambda problem, fit: left)
    text = identify.residual_warning(None, None)
    assert bool(text) == warns
    if warns:
        assert "does not explain these data: the residual is 3 times the noise in tip." in text


MISTYPED = (
    "--also: given 'tangential_frition'; allowed the names that slider effects lists; "
    "did you mean tangential_friction?"
)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--also", "tangential_frition"], MISTYPED),
        (["--per-frequency", "--also", "tangential_frition"], MISTYPED),
        (["--per-frequency", "--each", "C_x"], "--each: given 'C_x'; allowed C_d, m_a, k"),
        (["--channels", "torque"], "--channels: given 'torque'; allowed p_front"),
    ],
)
def test_unknown_names_are_refused(tank, tmp_path, capsys, arguments, message):
    assert main(["calibrate", str(tank), "--out", str(tmp_path / "out"), *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_shape_parameters_of_the_given_effects_are_fitted_too(monkeypatch):
    closed_form_tank.replace_the_beam(monkeypatch)
    experiment = closed_form_tank.experiment_of((1.0, 2.0, 3.0))
    truth = np.array([*TRUTH.values(), 0.02, 1.0])
    records = closed_form_tank.measured(experiment, [truth] * 3, 0)
    audited = SimpleNamespace(records=records, findings=[])
    monkeypatch.setattr(identify, "audit_measurements", lambda *arguments: audited)
    found = identify.identify_parameters(experiment, ("internal_friction",))
    assert found.fit.free.tolist() == list(range(6)) and found.fit.converged
    np.testing.assert_allclose(found.fit.theta[4:], truth[4:], atol=0.02)
    (table,) = tomllib.loads(identify.identified_model(found))["effects"]
    assert table["kappa_c"] == pytest.approx(found.fit.theta[5])
