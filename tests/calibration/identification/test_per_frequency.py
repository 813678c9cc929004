"""C_d and m_a by drive frequency: the comparison of ties on simulated tanks."""

import json
import tomllib

import numpy as np
import pytest

from calibration.audit.audit import Audited
from calibration.experiment_design import parameter_trial as design
from calibration.identification import identify, parameter_ties, per_frequency
from calibration.identification.per_frequency import compare_ties, comparison_text, tied_values
from calibration.identification.per_frequency_report import per_frequency_model
from calibration.inference.gauss_newton import fit_gauss_newton
from calibration.inference.problem import TankProblem
from calibration.inference.uncertainty import BASE_DISCREPANCY
from calibration.measurements.synthetic import ROBOT, START, Truth, random_trials, write_tank
from calibration.model.extended import base_vector, model_parameters
from calibration.model.plan import Resolution
from slider_jax.cli.main import main
from slider_jax.errors import InputError
from slider_jax.experiment.load import drag_and_added_mass, load
from slider_jax.experiment.schema import Trial
from tests.support import closed_form_tank as closed

pytestmark = pytest.mark.optimised

MESH = Resolution(21, 60, 3.0e-3)
TANK = {"nodes": 21, "step": 2e-3, "scheme": "sdirk2"}
ALSO = ("tangential_friction",)
FRICTION = {"tangential_friction": {"C_t": 0.1}}
COMMON = {"k": 0.075, "K_Q": 4.5e-7}


def write_ramp(folder, runs, coefficients):
    """Writes a tank in which every trial has its own C_d and m_a."""
    for number, (run, (C_d, m_a)) in enumerate(zip(runs, coefficients, strict=True)):
        truth = Truth(COMMON | {"C_d": C_d, "m_a": m_a}, FRICTION)
        write_tank(folder, truth, [run], number, numerics=TANK)
    return write_all(folder, runs)


def write_all(folder, runs):
    """Rewrite the experiment file of the last trial for all trials."""
    path = folder / "experiment.toml"
    head = path.read_text().split("[[trials]]")[0]
    tables = []
    for run in runs:
        lines = [f'{k} = "{v}"' if isinstance(v, str) else f"{k} = {v}" for k, v in run.items()]
        tables.append("[[trials]]\n" + "\n".join(lines) + "\n")
    path.write_text(head + "\n".join(tables))
    return path


def runs():
    """Returns trials at five frequencies from 1 to 5 Hz, on both sides of the ramp."""
    given = random_trials(5, count=5)
    return [
        run | {"frequency": f, "amplitude": 250e3, "duration": 1.2}
        for run, f in zip(given, (1.0, 1.6, 2.4, 3.4, 5.0), strict=True)
    ]


@pytest.fixture
def quick(monkeypatch):
    of, best = TankProblem.of, design.best_trial
    monkeypatch.setattr(
        identify.TankProblem, "of", lambda e, r, n, c, fine, coarse: of(e, r, n, c, MESH, MESH)
    )
    monkeypatch.setattr(design, "best_trial", lambda *given: best(*given[:6], MESH))


PAPER = [(4.0, 0.0), (4.0, 0.0), (3.6, 0.4), (3.0, 1.0), (3.0, 1.0)]
OWN_RAMP = [(3.0, 0.2), (3.0, 0.2), (3.6, 0.4), (4.5, 0.7), (4.5, 0.7)]
EACH = [(5.0, 0.9), (2.0, 0.3), (4.0, 0.8), (1.5, 0.2), (3.5, 0.7)]


@pytest.mark.slow
def test_the_true_ties_of_closed_form_readings_are_chosen(monkeypatch):
    closed.replace_the_beam(monkeypatch)
    at = (1.0, 1.6, 2.4, 3.4, 5.0)
    experiment, entries = closed.experiment_of(at), model_parameters(())
    for seed, (truth, chosen) in enumerate(
        [(PAPER, "paper"), ([(2.5, 0.6)] * 5, "constant"), (OWN_RAMP, "ramp")]
    ):
        thetas = [np.array([C_d, m_a, 0.075, 4.5e-7]) for C_d, m_a in truth]
        found = compared(experiment, entries, closed.measured(experiment, thetas, seed))
        assert found.chosen == chosen
        each = found.fitted["per_frequency"]
        for row, name in enumerate(("C_d", "m_a")):
            for (value, low, high, _), true in zip(tied_values(each, name), truth, strict=True):
                half = 0.5 * (high - low)
                assert abs(value - true[row]) < 1.5 * half
        model = tomllib.loads(per_frequency_model(found, ("C_d", "m_a")))["parameters"]
        if chosen == "ramp":
            given = [(x["frequency"], x["C_d"], x["m_a"]) for x in model["coefficients"]]
            assert np.array(given) == pytest.approx(np.array([(2, 3, 0.2), (3, 4.5, 0.7)]), rel=0.1)
        assert (model.get("force_coefficients") == "ramp") == (chosen == "paper")
        assert ("C_d" in model) == (chosen == "constant")


def test_values_by_frequency_fit_irregular_values(monkeypatch):
    closed.replace_the_beam(monkeypatch)
    experiment, entries = closed.experiment_of((1.0, 1.6, 2.4, 3.4, 5.0)), model_parameters(())
    thetas = [np.array([C_d, m_a, 0.075, 4.5e-7]) for C_d, m_a in EACH]
    found = compared(experiment, entries, closed.measured(experiment, thetas, 0))
    fits = {n: w.fit.square / w.fit.samples for n, w in found.fitted.items()}
    assert fits["per_frequency"] < 1.3 < 2.0 < fits["constant"]
    assert all(w.fit.difference is not None for w in found.fitted.values())  # hausman_check ran


def test_too_few_frequencies_choose_no_ties(monkeypatch):
    closed.replace_the_beam(monkeypatch)
    experiment, entries = closed.experiment_of((1.0, 2.4, 5.0)), model_parameters(())
    thetas = [np.array([4.0, 0.5, 0.075, 4.5e-7])] * 3
    records = closed.measured(experiment, thetas, 0)
    found = compared(experiment, entries, records)
    assert found.chosen is None and found.used.ties.name == "constant"
    assert "these data have only 3." in comparison_text(found)
    with pytest.raises(InputError, match="--each: given 'C_D'; allowed C_d, m_a"):
        compared(experiment, entries, records, each=("C_D",))
    one = [r for r in records if r.trial.frequency == 1.0]
    with pytest.raises(InputError, match="all trials are driven at 1 Hz"):
        compared(experiment, entries, one)


def compared(experiment, entries, records, each=("C_d", "m_a")):
    problem = closed.problem_of(experiment, records)
    start = base_vector(entries, START)
    initial = fit_gauss_newton(problem, entries, start, np.arange(len(entries)))
    return compare_ties(experiment, entries, problem, initial, each)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("coefficients", "chosen"), [(PAPER, "paper"), ([(2.5, 0.6)] * 5, "constant")]
)
def test_the_true_ties_of_the_beam_are_chosen(quick, tmp_path, coefficients, chosen):
    path, out = write_ramp(tmp_path, runs(), coefficients), tmp_path / "out"
    words = ["calibrate", str(path), "--out", str(out), "--per-frequency", "--also", *ALSO]
    assert main(words) == 0
    found = json.loads((out / "calibration.json").read_text())["per_frequency"]
    assert found["chosen"] == chosen
    each = found["ways"]["per_frequency"]["parameters"]
    for name, at in (("C_d", 0), ("m_a", 1)):
        for f, true in zip(found["frequencies_Hz"], coefficients, strict=True):
            x = each[f"{name} at {f:g} Hz"]
            width = x["high"] - x["low"]
            assert x["low"] - 0.3 * width < true[at] < x["high"] + 0.3 * width
    squares = {n: np.mean(x["left_out"]) for n, x in found["ways"].items()}
    assert squares[chosen] < 1.1 * min(squares.values())
    model = tomllib.loads((out / "model.toml").read_text())["parameters"]
    assert (model.get("force_coefficients") == "ramp") == (chosen == "paper")
    assert ("C_d" in model) == (chosen == "constant")
    load(path, out / "model.toml")
    rows = (out / "per_frequency.csv").read_text().splitlines()
    assert len(rows) == 6 and rows[0].startswith("frequency_Hz,trials,C_d,C_d_low,C_d_high")
    assert (out / "per_frequency.png").stat().st_size > 0


def test_ties_map_the_vector_to_the_parameters_of_each_trial():
    entries = model_parameters(())
    theta = base_vector(entries, START)
    trials_at = np.array([1.0, 2.5, 2.51, 4.0])
    at, place = parameter_ties.drive_frequencies([load_trial(f) for f in trials_at])
    assert at == pytest.approx([1.0, 2.505, 4.0]) and place.tolist() == [0, 1, 1, 2]
    ramp = parameter_ties.ramp_ties(entries, theta, at, place)
    x = np.array([0.1, 5e-7, 4.0, 3.0, 0.2, 1.0])
    assert ramp.labels[2:] == [
        "C_d below 2 Hz", "C_d above 3 Hz", "m_a below 2 Hz", "m_a above 3 Hz",
    ]  # fmt: skip
    middle = ramp.maps[1].at(x)
    assert middle == pytest.approx([4.0 - 0.505, 0.2 + 0.505 * 0.8, 0.1, 5e-7])
    assert ramp.maps[3].at(x) == pytest.approx([3.0, 1.0, 0.1, 5e-7])
    paper = parameter_ties.paper_ties(entries, theta, at, place)
    assert paper.maps[0].at(x[:2]) == pytest.approx([4.0, 0.0, 0.1, 5e-7])
    each = parameter_ties.per_frequency_ties(entries, theta, at, place, ("k",))
    assert each.labels[3:] == ["k at 1 Hz", "k at 2.505 Hz", "k at 4 Hz"]
    own = each.maps[2].at(np.array([3.0, 1.0, 5e-7, 0.1, 0.2, 0.3]))
    assert own == pytest.approx([3.0, 1.0, 0.2, 5e-7])
    assert not parameter_ties.spans_ramp(np.array([3.0, 4.0]))


def load_trial(frequency):
    return Trial(file="x.csv", frequency=frequency, amplitude=1e5, duration=1.0)


def test_the_proposed_trial_gives_the_predicted_interval(monkeypatch):
    """The data have no fast trial, so the best candidate is fast."""
    closed.replace_the_beam(monkeypatch)
    experiment = closed.experiment_of((0.6, 5.0, 0.8), phase=0.0)
    entries, free, theta = model_parameters(()), np.arange(4), np.array([3.0, 0.8, 0.075, 4.5e-7])
    seen = closed.measured(experiment, [theta] * 3, 0)
    few = closed.problem_of(experiment, seen[:1])
    one = fit_gauss_newton(few, entries, theta, free)
    candidates = [seen[2].trial, seen[1].trial]
    known = design.MeasuredInformation.of(few, one)
    found = design.best_trial(experiment, entries, one.theta, [0, 1], candidates, known)
    assert found[1].trial.frequency == 5.0
    after = fit_gauss_newton(closed.problem_of(experiment, seen[:2]), entries, one.theta, free)
    width = 1.96 * np.hypot(
        np.sqrt(after.covariance[1, 1]), BASE_DISCREPANCY["m_a"] * after.theta[1]
    )
    assert found[1].half_width == pytest.approx(width, rel=0.1)
    assert found[1].half_width < 0.7 * 1.96 * np.sqrt(one.covariance[1, 1])
    text = design.proposal_sentence(entries[1], found[1])
    assert text.startswith(
        "a trial of 1 s at 5 Hz, 250 kPa, phase 0, towed at 0.2 m/s, would determine m_a to ±"
    )


def test_the_information_of_a_proposed_trial_adds_to_the_data(monkeypatch):
    """Two similar trials together determine more than each of them."""
    closed.replace_the_beam(monkeypatch)
    experiment = closed.experiment_of((0.6, 0.8), phase=0.0, tow_speed=0.0)
    entries, free, theta = model_parameters(()), np.arange(4), np.array([3.0, 0.8, 0.075, 4.5e-7])
    seen = closed.measured(experiment, [theta] * 2, 0)
    few = closed.problem_of(experiment, seen[:1])
    one = fit_gauss_newton(few, entries, theta, free)
    known = design.MeasuredInformation.of(few, one)
    found = design.best_trial(experiment, entries, one.theta, [1], [seen[1].trial], known)
    after = fit_gauss_newton(closed.problem_of(experiment, seen), entries, one.theta, free)
    second = fit_gauss_newton(closed.problem_of(experiment, seen[1:]), entries, one.theta, free)

    def width(x):
        return 1.96 * np.hypot(np.sqrt(x.covariance[1, 1]), BASE_DISCREPANCY["m_a"] * x.theta[1])

    assert found[1].half_width == pytest.approx(width(after), rel=0.05)
    assert width(after) < 0.9 * min(width(one), width(second))


def test_a_held_out_frequency_does_not_affect_the_vector(monkeypatch):
    """The vector equals a fit to the other trials, and interpolates at the held-out frequency."""
    closed.replace_the_beam(monkeypatch)
    experiment, entries = closed.experiment_of((1.0, 2.0, 4.0, 5.0)), model_parameters(())
    thetas = [np.array([C_d, m_a, 0.075, 4.5e-7]) for C_d, m_a in
              [(3.0, 0.6), (3.0, 0.6), (3.3, 0.7), (3.0, 0.6)]]  # fmt: skip
    records = closed.measured(experiment, thetas, 2)
    problem = closed.problem_of(experiment, records)
    every, free = (
        fit_gauss_newton(problem, entries, base_vector(entries, START), np.arange(4)),
        np.arange(4),
    )
    others = closed.problem_of(experiment, [r for i, r in enumerate(records) if i != 2])
    alone = fit_gauss_newton(others, entries, base_vector(entries, START), free)
    at, place = parameter_ties.drive_frequencies(experiment.trials)
    ties = parameter_ties.constant_ties(entries, every.theta, at, place)
    without = per_frequency._without(ties, every, at, 2, place)
    error = np.sqrt(np.diag(alone.covariance))
    assert np.all(np.abs(without - alone.theta) < 0.3 * error)
    assert np.abs(every.theta - alone.theta)[1] > error[1]

    found = compare_ties(experiment, entries, problem, every)
    each = found.fitted["per_frequency"]
    x = per_frequency._without(each.ties, each.fit, at, 2, place)
    C_d = [v for v, p in zip(x, each.ties.entries, strict=True) if p.label == "C_d"]
    assert C_d[2] == pytest.approx(C_d[1] + (C_d[3] - C_d[1]) * 2.0 / 3.0)


def test_an_undetermined_parameter_gets_a_proposed_trial(monkeypatch):
    """One slow trial at a low pressure does not determine m_a."""
    closed.replace_the_beam(monkeypatch)
    monkeypatch.setattr(closed, "NOISE", {n: 20.0 * x for n, x in closed.NOISE.items()})
    experiment = closed.experiment_of((0.1, 4.0), amplitude=60e3)
    sensors = {
        "sensors.force_noise": 0.2,
        "sensors.tip_noise": 0.01,
        "sensors.pressure_noise": 14e3,
    }
    experiment = experiment.with_values(sensors)
    theta = np.array([3.0, 0.8, 0.075, 4.5e-7])
    records = closed.measured(experiment, [theta] * 2, 0)[:1]
    monkeypatch.setattr(identify, "audit_measurements", lambda *_: Audited(records, []))
    found = identify.identify_parameters(experiment)
    m_a = identify.identification_record(found, {})["parameters"]["m_a"]
    assert m_a["value"] is None and m_a["not_determined_by_these_data"]
    assert m_a["determined_by"]["trial"]["frequency"] == 4.0
    assert "not determined by these data" in identify.parameter_table(found)
    assert "at 4 Hz, 60 kPa" in identify.parameter_table(found)


def test_feasible_trials_are_within_the_ranges_of_the_experiment(tmp_path):
    path = write_all_only(tmp_path)
    grid = design.feasible_trials(load(path))
    given = load(path).trials
    assert {x.frequency for x in grid} == {1.0, 1.71, 2.92, 5.0}
    assert {x.tow_speed for x in grid} <= {x.tow_speed for x in given}
    assert {x.phase for x in grid} <= {x.phase for x in given}
    assert {x.frequency for x in design.feasible_trials(load(path), 2.4)} == {2.4}


def write_all_only(folder):
    (folder / "experiment.toml").write_text(
        'name = "x"\n\n[robot]\n'
        + "\n".join(f"{k} = {v}" for k, v in ROBOT.items())
        + "\n\n[parameters]\n"
        + "\n".join(f"{k} = {v}" for k, v in START.items())
        + "\n\n[[trials]]\n"
    )
    return write_all(folder, runs())


def test_a_coefficient_table_is_linear_between_its_frequencies_and_constant_beyond(tmp_path):
    path, model = write_all_only(tmp_path), tmp_path / "model.toml"
    model.write_text(
        '[parameters]\nforce_coefficients = "table"\n'
        "[[parameters.coefficients]]\nfrequency = 2.0\nC_d = 4.0\nm_a = 0.0\n"
        "[[parameters.coefficients]]\nfrequency = 3.0\nC_d = 3.0\nm_a = 1.0\n"
    )
    experiment = load(path, model)
    found = [drag_and_added_mass(experiment, t) for t in experiment.trials]
    expected = [(4.0, 0.0), (4.0, 0.0), (3.6, 0.4), (3.0, 1.0), (3.0, 1.0)]
    assert np.array(found) == pytest.approx(np.array(expected))
    model.write_text(model.read_text().replace("frequency = 3.0", "frequency = 1.0"))
    with pytest.raises(InputError, match="frequencies that increase from table to table"):
        load(path, model)
    model.write_text('[parameters]\nforce_coefficients = "table"\n')
    with pytest.raises(
        InputError, match="coefficients: given 0 tables; allowed at least one table"
    ):
        load(path, model)
