"""The lag from logs: the free run, its gradient, the fit, the interval, and the commands."""

import csv
import json
import math
import tomllib
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from calibration.cli import simulate_log
from calibration.inference.intervals import (
    RecordDerivatives,
    correlation_time,
    noise_floor,
    record_interval,
)
from calibration.pressure_logs.identify import identify_lag, rms
from calibration.pressure_logs.lag import (
    LogBatch,
    fit_each,
    fit_pooled,
    free_run,
    residual_psi,
    set_points,
)
from calibration.pressure_logs.read import PSI_PER_COUNT, ManifoldLog, read_log
from calibration.pressure_logs.residual_shape import harmonics, shape_of
from calibration.pressure_logs.text import describe_lag, lag_verdict
from slider_jax.cli.main import main
from slider_jax.errors import InputError
from tests.support.synthetic_log import PERIOD, lag_series, lagged, log_lines, write_log

NOISE = 1.7


def made(k=0.1, frequency=1.0, cycles=2.0, extra=None, **keywords):
    """Returns a log in memory, with `extra` counts added to the pressure."""
    command, pressure = lag_series(k, frequency, cycles, **keywords)
    if extra is not None:
        pressure = pressure + extra[: len(pressure)]
    t, idle = PERIOD * np.arange(len(command)), np.zeros(len(command))
    name = Path(f"{frequency:g}.txt")
    return ManifoldLog(name, frequency, PERIOD, t, command, pressure, idle, idle, ())


def evidence(fit, i=0):
    return RecordDerivatives(
        np.asarray(fit.residual[i]), np.asarray(fit.tangent[i]), float(fit.curvature[i])
    )


def test_the_free_run_equals_that_of_a_naive_loop():
    command, _ = lag_series(cycles=2.0)
    t = PERIOD * np.arange(len(command))
    run = free_run(0.1, set_points(jnp.asarray(t), jnp.asarray(command)), 250.0)
    np.testing.assert_allclose(run, lagged(0.1, command, 250.0), rtol=1e-11)


def test_the_gradient_of_the_free_run_equals_the_closed_form():
    k, start, step = 0.087, 20.0, 50.0
    t = jnp.linspace(0.0, 0.4, 201)
    points = set_points(t, jnp.full_like(t, step))
    found = jax.jacfwd(lambda x: free_run(x, points, start))(k)
    expected = (start - step) * jnp.exp(-t / k) * t / k**2
    np.testing.assert_allclose(found, expected, atol=1e-10)


def test_slope_and_curvature_agree_with_finite_differences_of_the_sum_of_squares():
    log = jax.tree.map(lambda x: x[0], LogBatch.of([made(k=0.15)]))
    fit = fit_each(LogBatch.of([made(k=0.15)]))

    def half_square(x):
        return 0.5 * float(jnp.sum(residual_psi(x, log) ** 2))

    x, d = float(fit.log_k[0]), 1e-3
    at = [half_square(x + i * d) for i in (-1, 0, 1)]
    assert float(fit.curvature[0]) == pytest.approx((at[0] - 2 * at[1] + at[2]) / d**2, rel=1e-4)
    slope = float(fit.tangent[0] @ fit.residual[0])
    assert abs(slope) < 1e-4 * math.sqrt(at[1] * float(fit.curvature[0]))


@pytest.mark.parametrize("k", [0.03, 0.087, 0.3])
def test_a_known_lag_is_recovered_within_its_interval(k):
    fit = fit_each(LogBatch.of([made(k=k, noise=NOISE, seed=3)]))
    found = record_interval(float(fit.log_k[0]), evidence(fit))
    assert bool(fit.converged[0]) and found.fixed
    assert found.low < k < found.high
    assert found.high < 1.02 * found.low
    assert 0.8 < found.widening < 1.3  # white noise: all samples are independent


@pytest.mark.slow
def test_the_interval_covers_the_truth_under_correlated_noise_and_the_naive_one_does_not():
    """Noise correlated over 50 ms, 100 logs: at least 88 of the 95 % intervals hold the truth."""
    k, memory, logs = 0.1, 0.05, []
    for seed in range(100):
        random = np.random.default_rng(seed)
        slow = np.zeros(1000)
        keep = math.exp(-PERIOD / memory)
        for i in range(1, 1000):
            slow[i] = keep * slow[i - 1] + math.sqrt(1 - keep**2) * random.normal()
        logs.append(made(k=k, cycles=2.0, noise=0.0, extra=10.0 * slow))
    fit = fit_each(LogBatch.of(logs))
    held = naive = 0
    for i in range(len(logs)):
        found = record_interval(float(fit.log_k[i]), evidence(fit, i))
        off = abs(math.log(k / found.value))
        width = math.log(found.high / found.value)
        held += off < width
        naive += off < width / found.widening
    assert held >= 88
    assert naive <= 60


def test_correlation_time_of_a_known_process():
    random = np.random.default_rng(1)
    white = random.normal(size=20000)
    slow = np.zeros(20000)
    for i in range(1, 20000):
        slow[i] = 0.9 * slow[i - 1] + white[i]
    assert correlation_time(white) == pytest.approx(1.0, abs=0.1)
    assert correlation_time(slow) == pytest.approx(19.0, rel=0.2)


def test_the_noise_floor_is_the_white_noise_without_the_signal():
    log = made(noise=NOISE, cycles=5.0)
    rounding = 1.0 / 12.0
    expected = PSI_PER_COUNT * math.sqrt(NOISE**2 + rounding)
    assert shape_of(log, np.zeros(len(log.t))).floor == pytest.approx(expected, rel=0.08)
    assert noise_floor(np.sin(np.arange(2000) * 0.01)) < 1e-6


def test_a_longer_log_in_the_batch_does_not_change_a_fit():
    short, long = made(k=0.12, cycles=1.5), made(k=0.12, cycles=4.0, seed=5)
    alone, beside = fit_each(LogBatch.of([short])), fit_each(LogBatch.of([short, long]))
    assert float(beside.log_k[0]) == pytest.approx(float(alone.log_k[0]), abs=1e-6)
    assert float(jnp.abs(beside.residual[0, len(short.t) :]).max()) == 0.0


@pytest.mark.slow
def test_logs_that_disagree_widen_the_common_interval():
    alike = identify_lag([made(k=0.1, frequency=f, seed=i) for i, f in enumerate((1.0, 1.1, 1.2))])
    apart = identify_lag(
        [made(k=k, frequency=f) for k, f in ((0.08, 1.0), (0.1, 1.1), (0.13, 1.2))]
    )
    assert alike.k.low < 0.1 < alike.k.high < 1.1 * alike.k.low
    assert apart.k.high > 1.5 * apart.k.low
    assert apart.k.high / apart.k.low > 1.2 * apart.within.high / apart.within.low
    assert 0.08 < apart.k.value < 0.13
    assert any("do not overlap" in line for line in describe_lag(apart))
    assert "One lag of" in lag_verdict(apart) and "does not explain these logs" in lag_verdict(
        apart
    )
    assert "explains these logs" in lag_verdict(alike)


def test_the_residual_of_a_true_lag_is_the_noise():
    found = identify_lag([made(k=0.15, noise=NOISE)])
    assert found.pooled_rmse("after") == pytest.approx(found.floor, rel=0.1)
    assert found.pooled_rmse("before") > 5.0 * found.floor
    assert lag_verdict(found).startswith("A lag of 150 ms explains this log: ")
    assert describe_lag(found)[0] == lag_verdict(found)


def test_the_shape_has_the_residuals_offset_and_harmonics():
    log = made(frequency=2.0, cycles=8.0)
    turn = 2 * math.pi * 2.0 * log.t
    shape = shape_of(log, 3.0 + 2.0 * np.cos(2 * turn) + 1.0 * np.sin(turn))
    assert shape.mean == pytest.approx(3.0, abs=1e-3)
    assert shape.mean_share == pytest.approx(9.0 / 11.5, rel=1e-3)
    assert shape.harmonic_shares[0] == pytest.approx(0.5 / 11.5, rel=1e-2)
    assert shape.harmonic_shares[1] == pytest.approx(2.0 / 11.5, rel=1e-3)
    assert shape.not_repeating_rms < 1e-6
    _, c, _ = harmonics(log.t, log.command, 2.0, 1)
    behind = -0.25 / 2.0  # a quarter period later
    late = np.real(c[0] * np.exp(2j * math.pi * 2.0 * (log.t + behind)))
    quarter = shape_of(log, late)
    assert quarter.quadrature == pytest.approx(abs(c[0]), rel=1e-2)
    assert abs(quarter.in_phase) < 0.02 * abs(c[0])


def test_gain_phase_and_rate_of_a_true_lag_give_its_k():
    log = made(k=0.1, frequency=1.5, cycles=8.0, noise=0.0)
    shape = shape_of(log, np.zeros(len(log.t)))
    assert shape.measured.k_of_gain == pytest.approx(0.1, rel=0.01)
    assert shape.measured.k_of_phase == pytest.approx(0.1, rel=0.01)
    assert shape.k_filling == pytest.approx(0.1, rel=0.02)
    assert shape.k_venting == pytest.approx(0.1, rel=0.02)


def test_a_log_with_a_constant_command_is_refused():
    still = made(amplitude=0.0)
    with pytest.raises(InputError, match="do not determine the lag k"):
        identify_lag([still])


def test_calibrate_manifold_end_to_end(tmp_path, capsys):
    paths = [
        write_log(tmp_path / f"{f:g}.txt", log_lines(k=0.15, frequency=f, cycles=2.0, seed=i))
        for i, f in enumerate((1.0, 1.5, 2.0))
    ]
    out = tmp_path / "out"
    assert main(["calibrate", "manifold", *map(str, paths), "--out", str(out)]) == 0
    report = json.loads((out / "manifold.json").read_text())
    model = (out / "model.toml").read_text()
    k = tomllib.loads(model)["parameters"]["k"]
    assert k == pytest.approx(0.15, rel=0.02)
    assert k == pytest.approx(report["pooled"]["k"]["value"], rel=1e-5)
    assert [x["frequency_Hz"] for x in report["logs"]] == [1.0, 1.5, 2.0]
    assert report["pooled"]["rmse_after_psi"] < 0.1 * report["pooled"]["rmse_before_psi"]
    pictures = {path.name for path in out.glob("*.png")}
    assert pictures == {
        "1.png", "1.5.png", "2.png",
        "k_by_frequency.png", "residual_by_phase.png", "residual_by_rate.png",
    }  # fmt: skip
    text = capsys.readouterr().out.splitlines()
    assert text[0].startswith("One lag of 150 ms explains these logs: ")
    assert model.splitlines()[0] == f"# {text[0]}"
    assert "RMSE in psi" in text[2]
    assert not list(out.glob(".tmp*"))


def _columns(path):
    with path.open() as file:
        table = list(csv.reader(file))
    return dict(zip(table[0], np.array(table[1:], float).T, strict=True))


@pytest.fixture
def coarse(monkeypatch):
    monkeypatch.setitem(simulate_log.NUMERICS, "nodes", 11)


@pytest.fixture(scope="module")
def short_log(tmp_path_factory):
    folder = tmp_path_factory.mktemp("log")
    lines = log_lines(k=0.15, frequency=4.0, cycles=1.5, amplitude=90.0, middle=180.0)
    return write_log(folder / "short.txt", lines)


@pytest.mark.slow
def test_simulate_runs_the_command_through_the_model(tmp_path, short_log, coarse):
    model = tmp_path / "model.toml"
    model.write_text("[parameters]\nk = 0.15\n")
    out = tmp_path / "out"
    arguments = ["simulate", str(short_log), "--model", str(model), "--out", str(out)]
    assert main([*arguments, "--plot"]) == 0
    columns = _columns(out / "short.csv")
    assert list(columns) == ["t_s", "p_front_Pa", "p_rear_Pa", "thrust_N", "recoil_N", "tip_m"]
    log = read_log(short_log)
    np.testing.assert_allclose(columns["t_s"], log.t, atol=1e-9)
    expected = lagged(0.15, log.command_Pa, log.pressure_Pa[0])
    np.testing.assert_allclose(columns["p_front_Pa"], expected, atol=0.06)
    np.testing.assert_array_equal(columns["p_front_Pa"], columns["p_rear_Pa"])
    assert np.ptp(columns["tip_m"]) > 0.005
    assert np.ptp(columns["recoil_N"]) > 0.05
    summary = json.loads((out / "summary.json").read_text())
    assert summary["settings"]["parameters"]["k"] == 0.15
    # Above 3 Hz the paper's ramp has ended.
    assert (summary["C_d"], summary["m_a"]) == (3.0, 1.0)
    assert summary["force_coefficients"] == "the paper's ramp at the log's frequency"
    assert summary["pressure_rmse_psi"] < 2.0 * NOISE * PSI_PER_COUNT
    assert (out / "short.png").stat().st_size > 10_000


@pytest.mark.slow
def test_simulate_can_use_the_measured_pressure(tmp_path, short_log, coarse):
    out = tmp_path / "out"
    assert main(["simulate", str(short_log), "--drive", "measured", "--out", str(out)]) == 0
    columns = _columns(out / "short.csv")
    np.testing.assert_allclose(columns["p_front_Pa"], read_log(short_log).pressure_Pa, atol=0.06)


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("[parameters]\nk = 150.0\n", "parameters.k"),
        ("[parameters]\nlag = 0.1\n", "lag"),
        ("[pressure]\nk = 0.1\n", "pressure"),
    ],
)
def test_the_error_names_a_bad_model_file_and_its_key(tmp_path, short_log, capsys, text, wrong):
    model = tmp_path / "model.toml"
    model.write_text(text)
    out = tmp_path / "out"
    arguments = ["simulate", str(short_log), "--model", str(model), "--out", str(out)]
    assert main(arguments) == 2
    message = capsys.readouterr().err
    assert str(model) in message and wrong in message
    assert not out.exists()


@pytest.mark.slow
def test_the_lag_does_not_explain_the_rigs_logs(data):
    logs = [read_log(path) for path in sorted((data / "manifold").glob("*.txt"))]
    found = identify_lag(logs)
    assert 8.0 < found.pooled_rmse("before") < 8.8
    assert 5.4 < found.pooled_rmse("pooled") < 5.9
    assert 0.15 < found.floor < 0.3
    assert 0.15 < found.k.low < 0.2 < found.k.high < 0.3
    by_frequency = {x.log.frequency: x for x in found.logs}
    assert by_frequency[0.25].k.high < by_frequency[1.1667].k.low
    assert rms(by_frequency[0.25].after) < 1.5
    # The fit finds the lowest minimum of a fine scan of the sum of squares.
    batch = LogBatch.of([by_frequency[1.4722].log])
    one = jax.tree.map(lambda x: x[0], batch)
    scan = jnp.log(jnp.linspace(0.05, 0.5, 91))
    square = jax.lax.map(lambda x: jnp.sum(residual_psi(x, one) ** 2), scan)
    assert float(jnp.exp(scan[jnp.argmin(square)])) == pytest.approx(
        by_frequency[1.4722].k.value, abs=0.006
    )
    assert bool(fit_pooled(batch).converged)
