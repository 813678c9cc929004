"""`slider simulate` from file to files, and what lies between."""

import dataclasses
import functools
import json
import shutil

import numpy as np
import pytest
from PIL import Image

from slider_jax.channels import SLIDER_CHANNELS
from slider_jax.cli.main import main
from slider_jax.errors import InputError
from slider_jax.experiment.load import load
from slider_jax.experiment.prepare import edge_steps, half_period_steps, sample_series
from slider_jax.io.files import staged, write_csv, write_json
from slider_jax.simulation.summary import averaging_window, is_periodic, trial_summary
from slider_jax.simulation.trial import CHUNK, simulate_trial
from tests.support.experiments import write_small_experiment

run_trial = functools.partial(simulate_trial, shape=True)  # one compiled program for all tests


def _read(path):
    return np.genfromtxt(path, delimiter=",", names=True)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """Both trials of the small experiment, through the command line, with pictures."""
    folder = tmp_path_factory.mktemp("simulate")
    out = folder / "out"
    assert main(["simulate", str(write_small_experiment(folder)), "--out", str(out), "--plot"]) == 0
    return folder, out


def test_files_columns_and_sample_times(simulated):
    _, out = simulated
    pictures = {f"trial_0{i}{end}.png" for i in (0, 1) for end in ("", "_midlines")}
    assert {p.name for p in out.iterdir()} == pictures | {
        "trial_00.csv",
        "trial_01.csv",
        "summary.json",
    }
    for name, last in (("trial_00.csv", 0.75), ("trial_01.csv", 0.9)):
        columns = _read(out / name)
        assert columns.dtype.names == SLIDER_CHANNELS.columns
        np.testing.assert_allclose(columns["t_s"], np.arange(len(columns)) / 500, atol=1e-12)
        assert columns["t_s"][-1] == last
        assert [columns[name][0] for name in SLIDER_CHANNELS.columns] == [
            0.0
        ] * 6  # the initial state
        assert np.ptp(columns["recoil_N"]) > 0.1 and np.ptp(columns["tip_m"]) > 0.005


def test_pressures_follow_the_lag_in_closed_form(simulated):
    """Exponentials between the edges of the square wave, summed over the edges so far."""
    _, out = simulated
    columns = _read(out / "trial_00.csv")
    t, k, f = columns["t_s"], 0.087, 4.0
    for name, amplitude, phase in (("p_front_Pa", 1.5e5, 0.0), ("p_rear_Pa", 1.35e5, 0.1)):
        expected = np.zeros_like(t)
        edges = (np.arange(-2, 8) / 2 + phase) / f
        signs = np.where(np.arange(-2, 8) % 2 == 0, 1.0, -1.0)
        level = 0.0
        for edge, sign in zip(edges, signs, strict=True):
            if edge <= 1e-12:
                level = sign * amplitude
                begin = 0.0
                expected = level * -np.expm1(-t / k)
            else:
                jump = sign * amplitude - level
                level = sign * amplitude
                after = t > edge
                begin = t[after] - edge
                expected[after] += jump * -np.expm1(-begin / k)
        np.testing.assert_allclose(columns[name], expected, atol=1.0)  # Pa, of 1.5e5


def test_summary_means_are_those_of_the_columns(simulated):
    """Against plain means of the sampled columns over the same window."""
    folder, out = simulated
    summary = json.loads((out / "summary.json").read_text())
    assert summary["seed"] is None and len(summary["input"]["sha256"]) == 64
    expected = {"slider_jax", "python", "jax", "equinox", "optimistix", "lineax", "numpy"}
    assert expected <= set(summary["versions"])
    assert summary["settings"]["robot"]["EA_body"] == 1e5
    first = summary["trials"][0]
    assert first["averaged"] == "last stride" and first["averaged_to_s"] == 0.75
    columns = _read(out / "trial_00.csv")
    last = columns["t_s"] > 0.5 + 1e-9
    assert first["mean_thrust_N"] == pytest.approx(columns["thrust_N"][last].mean(), abs=2e-4)
    rms = np.sqrt(np.mean(columns["recoil_N"][last] ** 2))
    assert first["recoil_rms_N"] == pytest.approx(rms, rel=5e-3)
    assert first["tip_half_range_m"] == pytest.approx(np.ptp(columns["tip_m"][last]) / 2, rel=2e-3)


def test_towing_starts_at_speed_and_costs_thrust(tmp_path):
    """Straight and towed along itself, the body meets no crossflow: no force until it bends."""
    quiet = ("amplitude = 150000.0", "amplitude = 0.0"), ("tow_speed = 0.0", "tow_speed = 0.3")
    run = run_trial(load(write_small_experiment(tmp_path, *quiet)), 0)
    for name in ("thrust", "recoil", "tip"):
        np.testing.assert_allclose(run.series[name], 0.0, atol=1e-9)
    stationary = run_trial(
        load(write_small_experiment(tmp_path, ("tow_speed = 0.2", "tow_speed = 0.0"))), 1
    )
    towed = run_trial(load(write_small_experiment(tmp_path)), 1)
    assert np.abs(towed.series["recoil"] - stationary.series["recoil"]).max() > 0.02


def test_frames_of_the_sections_belong_to_the_midline(tmp_path):
    """In a cell, the midline has the mean direction of the tau of its two nodes; b is upward."""
    series = run_trial(load(write_small_experiment(tmp_path)), 0).series
    w, x, y, z = np.moveaxis(series["frame"], 1, 0)
    assert not x.any() and not y.any()
    heading = 2.0 * np.arctan2(z, w)
    steps = np.diff(series["midline"], axis=2)
    mean = 0.5 * (heading[:, 1:] + heading[:, :-1])
    np.testing.assert_allclose(np.arctan2(steps[:, 1], steps[:, 0]), mean, atol=1e-9)
    assert np.abs(heading).max() > 0.1


@pytest.mark.slow
def test_a_stream_equals_towing_through_still_water(tmp_path):
    finer = ("nodes = 11", "nodes = 21")
    towed = run_trial(load(write_small_experiment(tmp_path, finer)), 1)
    streamed = load(
        write_small_experiment(
            tmp_path,
            finer,
            ("tow_speed = 0.2", "tow_speed = 0.0"),
            ("[sensors]", "[water]\nvelocity = [-0.2, 0.0]\n[sensors]"),
        )
    )
    run = run_trial(streamed, 1)
    for name in ("thrust", "recoil", "tip"):  # equal but for the discretisation
        scale = np.ptp(towed.series[name])
        np.testing.assert_allclose(run.series[name], towed.series[name], atol=2e-3 * scale)


@pytest.mark.slow
def test_measured_pressure_in_place_of_the_lag_gives_the_same_forces(simulated, tmp_path):
    """The pressures that the lag gave, sampled every 2 ms and played back without the lag."""
    folder, out = simulated
    path = write_small_experiment(
        tmp_path,
        (
            "frequency = 4.0\namplitude = 150000.0",
            'waveform = "recorded"\ndrive_file = "drive.csv"\ndrive_is = "measured"',
        ),
    )
    shutil.copy(out / "trial_00.csv", tmp_path / "drive.csv")
    played, original = run_trial(load(path), 0), _read(out / "trial_00.csv")
    assert played.grid.h == pytest.approx(0.002)
    assert trial_summary(load(path), played)["averaged"] == "second half"
    for name, part in (
        ("p_front_Pa", 1e-5),
        ("p_rear_Pa", 1e-5),
        ("recoil_N", 2e-2),
        ("tip_m", 1e-2),
    ):
        bar = part * np.ptp(original[name])
        np.testing.assert_allclose(played.columns[name], original[name], atol=bar)


def test_a_measured_record_is_sampled_at_its_own_times(tmp_path):
    path = write_small_experiment(tmp_path)
    own = np.sort(np.random.default_rng(0).uniform(0.0, 0.75, 375))
    own = np.arange(375) * 0.002 + 0.0004 * (own / 0.75 - 0.5) + 0.0002
    write_csv(tmp_path / "trial_00.csv", {"t_s": own, "tip_m": 0.0 * own})
    run, even = run_trial(load(path), 0), run_trial(load(write_small_experiment(tmp_path)), 1)
    np.testing.assert_allclose(run.columns["t_s"], own, rtol=1e-8)
    assert even.columns["t_s"][1] == 0.002


@pytest.mark.slow
def test_same_result_whatever_the_number_of_chunks(tmp_path):
    """The state and the pressures carried from chunk to chunk are all there is to carry."""
    experiment = load(write_small_experiment(tmp_path))
    whole = run_trial(experiment, 0)
    assert 100 < whole.grid.steps < CHUNK
    split = run_trial(experiment, 0, chunk=37)
    for name in ("p_front", "p_rear", "recoil", "tip"):
        scale = np.abs(whole.series[name]).max()
        np.testing.assert_allclose(split.series[name], whole.series[name], atol=1e-9 * scale)


def test_window_is_half_of_the_whole_strides_and_ends_with_the_trial(tmp_path):
    experiment = load(write_small_experiment(tmp_path, ("duration = 0.75", "duration = 1.4")))
    run = run_trial(experiment, 0)
    span, strides = averaging_window(run)
    assert strides == 2  # of 5.6
    summary = trial_summary(experiment, run)
    assert summary["averaged_to_s"] - summary["averaged_from_s"] == pytest.approx(2 / 4.0)
    assert summary["averaged_to_s"] == pytest.approx(1.4, abs=run.grid.h)
    assert summary["mean_thrust_N"] == pytest.approx(run.series["thrust"][span].mean())
    assert summary["thrust_std_N"] > 0.0


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """A run of the first trial, three strides of 0.25 s, whose series the tests replace."""
    return run_trial(load(write_small_experiment(tmp_path_factory.mktemp("short"))), 0)


def _with(run, thrust, tip):
    """The run with these functions of the time in strides for its series."""
    turns = 4.0 * run.t
    series = run.series | {"thrust": thrust(turns), "tip": tip(turns)}
    return dataclasses.replace(run, series=series)


def _wave(turns):
    return 0.02 * np.sin(2 * np.pi * turns)


@pytest.mark.parametrize(
    "thrust, growth, expected",
    [
        (lambda x: 0.2 + _wave(x), 0.0, None),
        (lambda x: 0.2 + 0.0015 * x, 0.0, None),  # by 0.75 %
        (lambda x: 0.2 + 0.0030 * x, 0.0, "mean thrust from 204.53 to 207.53 mN"),
        (lambda x: 0.0009 * x, 0.0, None),  # below a millinewton, whatever the fraction
        (lambda x: 0.0 * x, 0.1, "range of the tip from 45.95 to 49.94 mm"),
        (lambda x: 0.0 * x, 0.001, None),
    ],
)
def test_a_trial_is_periodic_if_its_last_two_strides_agree(short, thrust, growth, expected):
    run = _with(short, thrust, lambda x: (1.0 + growth * x) * _wave(x))
    periodic, warning = is_periodic(run)
    assert periodic is (expected is None)
    assert expected is None or (
        expected in warning and "extend the trial (duration = 1.5)" in warning
    )


def test_trials_of_less_than_two_strides_say_so(short):
    def cut(strides):
        steps = round(strides * 2 * short.grid.half_period)
        grid = dataclasses.replace(short.grid, steps=steps)
        prepared = dataclasses.replace(short.prepared, grid=grid)
        return dataclasses.replace(short, prepared=prepared)

    assert is_periodic(cut(1.9)) == (
        None,
        "the trial is too short to compare two strides; the motion may not be periodic",
    )
    periodic, warning = is_periodic(cut(0.8))
    assert periodic is None
    assert "the stride (0.25 s) is longer than the trial; means cover the trial" in warning
    assert averaging_window(cut(0.8)) == (slice(1, cut(0.8).grid.steps + 1), 0)


def test_a_trial_that_is_not_periodic_warns_on_stderr_and_in_the_summary(tmp_path, capsys):
    out = tmp_path / "out"
    assert (
        main(["simulate", str(write_small_experiment(tmp_path)), "--out", str(out), "--plot"]) == 0
    )
    trials = json.loads((out / "summary.json").read_text())["trials"]
    assert [trial["periodic"] for trial in trials] == [False, False]
    said = capsys.readouterr().err
    for trial in trials:
        (warning,) = trial["warnings"]
        assert warning.startswith("not periodic: ")
        assert f"{trial['file']}  warning: {warning}" in said


def test_errors_against_the_measured_file_are_told_by_channel(simulated, tmp_path, capsys):
    """What was simulated, shifted by known offsets, half of the tip's cells blank."""
    path, (_, out) = write_small_experiment(tmp_path), simulated
    columns = _read(out / "trial_00.csv")
    offsets = {"p_front_Pa": 2e3, "thrust_N": 0.03, "tip_m": -0.004}
    shifted = {name: columns[name] + offset for name, offset in offsets.items()}
    shifted["tip_m"][::2] = np.nan
    write_csv(tmp_path / "trial_00.csv", {"t_s": columns["t_s"], **shifted})
    again = tmp_path / "out"
    assert main(["simulate", str(path), "--out", str(again), "--plot"]) == 0
    trials = json.loads((again / "summary.json").read_text())["trials"]
    expected = {name: abs(offset) for name, offset in offsets.items()}
    assert trials[0]["rmse_to_measured"] == pytest.approx(expected, rel=1e-3)
    assert trials[1]["rmse_to_measured"] is None
    said = capsys.readouterr().err
    assert "rms error: front pressure 2 kPa, thrust 30 mN, tip, lateral 4 mm\n" in said


@pytest.mark.parametrize("phase, expected", [(0.0, 209), (0.15, 210), (0.123, 209), (-0.1, 210)])
def test_steps_put_both_chambers_edges_on_steps_where_they_can(phase, expected):
    assert half_period_steps(4.8, 5e-4, (0.0, phase)) == expected


def test_sampling_is_exact_for_cubics_and_does_not_cross_an_edge():
    t = np.linspace(0.0, 1.0, 41)
    edges = edge_steps(40, 10, (0.0, 0.2))
    np.testing.assert_array_equal(edges, [0, 4, 10, 14, 20, 24, 30, 34, 40])
    at = np.random.default_rng(1).uniform(0.0, 1.0, 500)
    for edge in (0.1, 0.25, 0.85):

        def kinked(x, edge=edge):
            return 1.0 + x - x**3 + np.where(x > edge, 40.0 * (x - edge) ** 2 + 9.0 * (x - edge), 0)

        np.testing.assert_allclose(sample_series(t, kinked(t), at, edges), kinked(at), atol=1e-12)
    smeared = sample_series(t, kinked(t), at, np.array([0, 40]))
    assert np.abs(smeared - kinked(at)).max() > 1e-3


def test_sampling_keeps_further_axes():
    t = np.linspace(0.0, 2.0, 21)
    values = np.stack([t**2, 1.0 - t], axis=1)
    at = np.array([0.0, 0.33, 1.999, 2.0])
    found = sample_series(t, values, at, np.array([0, 20]))
    np.testing.assert_allclose(found, np.stack([at**2, 1.0 - at], axis=1), atol=1e-13)


def test_staged_files_appear_together_or_not_at_all(tmp_path):
    out = tmp_path / "deep" / "out"
    with pytest.raises(RuntimeError), staged(out) as stage:
        write_json(stage / "a.json", {"x": float("nan")})
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []
    with (
        pytest.raises(InputError, match="cannot create the folder"),
        staged(tmp_path / (300 * "x")),
    ):
        pass
    out.mkdir(parents=True)
    (out / "a.json").write_text("old")
    with pytest.raises(RuntimeError), staged(out):
        raise RuntimeError
    with staged(out) as stage:
        write_json(stage / "a.json", {"x": float("nan"), "y": np.arange(2)})
        assert (out / "a.json").read_text() == "old"
    assert json.loads((out / "a.json").read_text()) == {"x": None, "y": [0, 1]}
    assert [p.name for p in out.iterdir()] == ["a.json"]


def test_animation_is_written(simulated, monkeypatch):
    from slider_jax.simulation import animation as animate
    from slider_jax.simulation.animation import animate_run

    monkeypatch.setattr(animate, "FRAMES_PER_STRIDE", 4)
    folder, _ = simulated
    run, told = run_trial(load(folder / "experiment.toml"), 0), []
    with Image.open(animate_run(run, folder, lambda *numbers: told.append(numbers))) as film:
        assert film.n_frames == 9 and told == [(i, 9) for i in range(1, 10)]
        frames = []
        for i in (0, 3):
            film.seek(i)
            frames.append(np.asarray(film.convert("L"), float))
    moved = np.abs(frames[1] - frames[0]) > 60.0
    assert 200 < moved.sum() < 0.1 * moved.size  # the body and the cursor, not the axes


@pytest.mark.slow
def test_verification_case_from_the_command_line(data, tmp_path):
    """An independent program's case, to the bars that hold at this step and N_p = 51."""
    case = data / "verification" / "towed_4p8Hz"
    expected = {
        c["case"]: c for c in json.loads((data / "verification" / "cases.json").read_text())
    }
    expected = expected["towed_4p8Hz"]
    arguments = ["simulate", str(case / "experiment.toml"), "--out", str(tmp_path)]
    assert main(arguments) == 0
    found, reference = _read(tmp_path / "trial_00.csv"), _read(case / "trial_00.csv")
    np.testing.assert_array_equal(found["t_s"], reference["t_s"])
    for name, bar in (("recoil_N", 0.06), ("tip_m", 0.03)):
        error = np.sqrt(np.mean((found[name] - reference[name]) ** 2)) / reference[name].std()
        assert error < bar
    result = json.loads((tmp_path / "summary.json").read_text())["trials"][0]
    assert result["averaged"] == "last 4 strides"
    assert 1e3 * result["mean_thrust_N"] == pytest.approx(expected["mean_thrust_mN"], abs=1.0)
    assert result["recoil_rms_N"] == pytest.approx(expected["recoil_rms_N"], rel=0.02)
    assert 1e3 * result["tip_half_range_m"] == pytest.approx(
        expected["tip_half_range_mm"], rel=0.01
    )
