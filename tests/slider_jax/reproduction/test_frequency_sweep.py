"""The paper's sweep at a small size against single rollouts; its files and its table."""

import csv
import dataclasses
import json
import time

import numpy as np
import pytest

from slider_jax import paper
from slider_jax.batch.chunks import chunks_of, run_in_threads, stack
from slider_jax.beam.parameters import Numerics
from slider_jax.observables import stride_means, thrust
from slider_jax.reproduction.frequency_sweep import (
    SHOWN_FREQUENCIES,
    FrequencySweepSettings,
    run_frequency_sweep,
)
from slider_jax.reproduction.frequency_sweep_report import comparison, write_frequency_sweep
from tests.support.helpers import arrays, march

COARSE = Numerics(tail_cells=2, body_cells=8)
TINY = FrequencySweepSettings(
    frequencies=(1.0, 2.4, 4.8), steps_per_stride=40, strides=4, transient=2, numerics=COARSE
)


@pytest.fixture(scope="module")
def sweep():
    calls = []
    result = run_frequency_sweep(
        TINY, lambda strides: calls.append(strides), lambda: calls.append(1)
    )
    assert calls[0] == sum(calls[1:]) > 0  # the announced number of steps
    return result


@pytest.mark.parametrize("index", [0, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_each_frequency_equals_a_single_rollout(sweep, index):
    f = TINY.frequencies[index]
    h = 1.0 / (f * TINY.steps_per_stride)
    model = arrays(paper.head_fixed(f))
    _, single = march(model, h, TINY.strides * TINY.steps_per_stride, thrust, COARSE)
    expected = np.asarray(stride_means(single, TINY.steps_per_stride))
    np.testing.assert_allclose(sweep.stride_thrust[index], expected, rtol=0, atol=1e-10)
    np.testing.assert_allclose(sweep.table["thrust_mean_N"][index], expected[2:].mean(), atol=1e-10)
    np.testing.assert_allclose(
        sweep.table["thrust_std_of_strides_N"][index], expected[2:].std(ddof=1), atol=1e-10
    )
    if f in SHOWN_FREQUENCIES:
        np.testing.assert_allclose(sweep.shown[f].channels["thrust"], single, rtol=0, atol=1e-10)


def test_coefficients_in_the_table_are_on_the_ramp(sweep):
    np.testing.assert_allclose(sweep.table["C_d"], [4.0, 3.6, 3.0])
    np.testing.assert_allclose(sweep.table["m_a"], [0.0, 0.4, 1.0], atol=1e-12)


def test_results_are_written_and_read_back(sweep, tmp_path):
    write_frequency_sweep(sweep, TINY, tmp_path)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {
        "settings.json",
        "sweep.csv",
        "thrust_against_frequency.png",
        "series_1Hz.csv",
        "series_4p8Hz.csv",
        "stride_1Hz.png",
        "stride_4p8Hz.png",
    }
    with open(tmp_path / "sweep.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["frequency_Hz"]) for row in rows] == list(TINY.frequencies)
    np.testing.assert_allclose(
        [float(row["thrust_mean_N"]) for row in rows], sweep.table["thrust_mean_N"], rtol=1e-8
    )
    record = json.loads((tmp_path / "settings.json").read_text())
    assert record["settings"]["assumed"]["amplitude"] == paper.Assumed().amplitude
    assert "amplitude" in " ".join(record["assumed"])
    assert record["versions"]["jax"]


def test_the_table_has_a_verdict_for_each_value(sweep):
    def verdicts(thrust_mN, share):
        """`share` is the fraction of each steady stride in which the recoil is 1.1 N."""
        f = np.array([1.0, 2.4, 4.8, 6.8])
        table = {name: np.zeros(4) for name in sweep.table} | {"frequency_Hz": f}
        table |= {"thrust_mean_N": 1e-3 * np.asarray(thrust_mN)}
        steps, shown = TINY.steps_per_stride, {}
        for frequency, series in sweep.shown.items():
            recoil = np.tile(np.where(np.arange(steps) < share * steps, -1.1, 0.9), TINY.strides)
            shown[frequency] = series._replace(channels=series.channels | {"recoil": recoil})
        changed = sweep._replace(table=table, shown=shown, ok=np.ones(4, bool))
        lines = comparison(changed, TINY).splitlines()
        return [line.split()[-1] for line in lines[1:6]]

    spread = 1e3 * sweep.table["thrust_std_of_strides_N"][2]
    assert f" mN (s.d. of strides {spread:.1f})" in comparison(sweep, TINY)
    assert verdicts([-20.0, 5.0, 61.0, 21.0], 0.5) == 5 * ["agrees"]
    assert verdicts([-1.0, -20.0, 40.0, 35.0], 0.0) == 5 * ["differs"]
    assert verdicts([-20.0, 5.0, 50.0, 61.0], 0.5)[2] == "available"  # no roll-off in the sweep
    # The right thrust at the wrong frequency differs too.
    assert verdicts([-20.0, 61.0, 55.0, 21.0], 0.6)[1:] == ["differs"] * 2 + ["agrees", "differs"]


def test_a_failed_frequency_is_nan_and_listed(sweep):
    nan = np.array([np.nan, *sweep.table["thrust_mean_N"][1:]])
    failed = sweep._replace(
        table=sweep.table | {"thrust_mean_N": nan}, ok=np.array([False, True, True])
    )
    assert "Not converged: 1 Hz" in comparison(failed, TINY)


def test_a_failing_robot_does_not_affect_the_others(sweep):
    wild = dataclasses.replace(TINY, assumed=paper.Assumed(amplitude=np.nan))
    assert not run_frequency_sweep(wild).ok.any()
    assert sweep.ok.all()


def test_the_papers_sweep_has_34_frequencies_from_0p4_to_7_hz():
    assert len(paper.SWEEP) == 34
    np.testing.assert_allclose(np.diff(paper.SWEEP), 0.2)
    assert (paper.SWEEP[0], paper.SWEEP[-1]) == (0.4, 7.0)
    assert set(SHOWN_FREQUENCIES) <= set(paper.SWEEP)


@pytest.mark.parametrize("robots, workers", [(34, 2), (1, 4), (8, 1), (17, 3), (100, 2)])
def test_chunks_contain_every_robot_once(robots, workers):
    chunks = chunks_of(robots, 8, workers)
    held = [chunks.indices(c)[: chunks.distinct(c)] for c in range(chunks.total)]
    np.testing.assert_array_equal(np.concatenate(held), np.arange(robots))
    assert all(len(chunks.indices(c)) == chunks.size <= 8 for c in range(chunks.total))


def test_an_error_in_a_thread_is_raised_and_cancels_the_other_chunks():
    begun = []

    def work(chunk, stopped):
        begun.append(chunk)
        if chunk == 1:
            raise ZeroDivisionError
        time.sleep(0.01)
        return chunk

    with pytest.raises(ZeroDivisionError):
        list(run_in_threads(work, list(range(50)), 1))
    assert len(begun) < 50


def test_stacked_numbers_become_floats():
    assert stack([{"x": 1}, {"x": 2}])["x"].dtype == np.float64
