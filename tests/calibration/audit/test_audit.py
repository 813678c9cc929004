"""The audit reports and handles each kind of damage, and undamaged data give no finding."""

import re

import numpy as np
import pytest

from calibration.audit.audit import audit_measurements
from calibration.audit.prediction import residual_outliers
from calibration.audit.sensors import Quantisation, clipped, quantisation, spikes, stuck
from slider_jax.errors import InputError
from slider_jax.experiment import load as experiment
from tests.support import damage
from tests.support.damage import ROW, alter, audited, kinds, lines_of, only, record, same_as_whole


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return damage.write_experiment(tmp_path_factory.mktemp("whole")).parent


@pytest.fixture
def tank(whole, tmp_path):
    """A copy of the undamaged experiment; a test damages the copy."""
    for file in whole.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    return tmp_path


# Undamaged data


def test_undamaged_data_give_no_finding(whole):
    found = audited(whole)
    assert [str(x) for x in found.findings] == []
    assert len(found.records) == 8
    same_as_whole(found, whole, 3)


@pytest.mark.parametrize(
    "physics", [{"delay": 0.03, "gain": 1.2}, {"k": 0.03}, {"k": 0.2, "gain": 0.8}]
)
def test_a_deviation_that_all_trials_share_is_no_fault(tmp_path, physics):
    damage.write_experiment(tmp_path, 1, **physics)
    assert [str(x) for x in audited(tmp_path).findings] == []


@pytest.mark.parametrize("name", ["open_null", "open_delay", "open_clamp", "open_skin",
                                  "blind_a", "blind_b", "blind_c"])  # fmt: skip
def test_the_measured_sets_give_no_finding(data, name):
    found = audit_measurements(experiment.load(data / "sets" / name / "experiment.toml"))
    assert [str(x) for x in found.findings] == []
    assert len(found.records) == 8


# Rows and times


@pytest.mark.parametrize(("number", "first", "many"), [(0, 350, 40), (3, 100, 150), (7, 300, 7)])
def test_a_gap_is_reported_and_the_rows_stay_missing(tank, whole, number, first, many):
    def cut(lines):
        return lines[: first + 1] + lines[first + 1 + many :]

    lines_of(tank, number, cut)
    found = audited(tank)
    only(found, number, ("gap", None, "used"))
    assert f"{many} rows are missing" in found.findings[0].detail
    t, values = damage.read(whole / f"trial_{number:02d}.csv")
    r = record(found, number)
    np.testing.assert_allclose(r.t, t, atol=1e-9)
    there = np.isfinite(r.values[3])
    assert (~there).nonzero()[0].tolist() == list(range(first, first + many))
    np.testing.assert_array_equal(r.values[:, there], values[:, there])


@pytest.mark.parametrize("end", ["start", "end"])
def test_missing_rows_at_an_end_are_reported(tank, end):
    lines_of(tank, 2, lambda x: [x[0], *x[200:]] if end == "start" else x[:-200])
    found = audited(tank)
    only(found, 2, ("gap", None, "used"))
    assert len(found.records) == 8


@pytest.mark.parametrize("where", ["each", "block at its place", "block at the end"])
def test_doubled_rows_are_dropped(tank, whole, where):
    def double(lines):
        if where == "each":
            return [lines[0], *(x for line in lines[1:] for x in (line, line))]
        block = lines[300:400]
        return [*lines[:400], *block, *lines[400:]] if "place" in where else [*lines, *block]

    lines_of(tank, 4, double)
    found = audited(tank)
    assert kinds(found) == [("doubled_rows", None, "mended")]
    same_as_whole(found, whole, 4)


def test_rows_with_the_readings_of_the_previous_row_are_masked(tank):
    def stale(t, values):
        values[:, 500:600:2] = values[:, 499:599:2]
        return t, values

    def camera(t, values):  # the repeated rows must not move the camera's frames
        t, values = stale(t, values)
        values[4, 1::8] = np.nan
        return t, values

    alter(tank, 1, camera)
    found = audited(tank)
    assert ("doubled_rows", None, "masked") in kinds(found, 1)
    assert np.isnan(record(found, 1).values[2, 500:600:2]).all()
    assert len(found.records) == 8


def test_rows_of_a_stuck_logger_are_masked(tank):
    def freeze(t, values):
        values[:, 400:450] = values[:, 400:401]
        return t, values

    alter(tank, 1, freeze)
    found = audited(tank)
    only(found, 1, ("stuck", None, "masked"))
    assert np.isnan(record(found, 1).values[:, 401:450]).all()


def test_unsorted_rows_are_sorted(tank, whole):
    lines_of(tank, 5, lambda x: [x[0], *x[300:400], *x[1:300], *x[400:]])
    found = audited(tank)
    only(found, 5, ("unsorted", "t_s", "mended"))
    same_as_whole(found, whole, 5)


def test_two_runs_in_one_file_are_left_out(tank):
    other = (tank / "trial_06.csv").read_text().splitlines()[1:]
    lines_of(tank, 5, lambda x: [*x, *other])
    found = audited(tank)
    only(found, 5, ("unsorted", "t_s", "left out"))
    assert len(found.records) == 7


TEXT = {
    "torn": (lambda s: s[:-17], ("torn_line", None, "masked")),
    "short rows": (
        lambda s: s.replace("\n0.6", "\n0.6,0.1\n0.6", 3), ("bad_row", None, "masked")),
    "nan": (lambda s: re.sub(r",[-\d.]+,([-\d.]*,[-\d.]*)\n1\.2", r",nan,\1\n1.2", s),
            ("bad_cell", "thrust_N", "masked")),
    "words": (lambda s: re.sub(r",[-\d.]+(,[-\d.]*)\n1\.2", r",over\1\n1.2", s),
              ("bad_cell", "recoil_N", "masked")),
    "inf": (lambda s: re.sub(r",[-\d.]+(,[-\d.]*)\n1\.2", r",-inf\1\n1.2", s),
            ("bad_cell", "recoil_N", "masked")),
}  # fmt: skip


@pytest.mark.parametrize("name", TEXT)
def test_bad_rows_and_cells_are_reported_and_the_rest_is_used(tank, name):
    change, expected = TEXT[name]
    path = tank / "trial_02.csv"
    before = path.read_text()
    path.write_text(change(before))
    assert path.read_text() != before
    found = audited(tank)
    assert kinds(found, 2)[0] == expected
    assert set(kinds(found, 2)[1:]) <= {("gap", expected[1][:-2] if expected[1] else None, "used")}
    assert len(found.records) == 8
    assert np.isfinite(record(found, 2).values[3]).mean() > 0.8


def test_the_report_says_how_many_cells_of_a_sensor_are_bad(tank):
    rows = []

    def lose_thrust(lines):
        header, *rows[:] = lines
        at = header.split(",").index("thrust_N")
        cells = [x.split(",") for x in rows]
        return [header, *(",".join([*x[:at], "nan", *x[at + 1 :]]) for x in cells)]

    lines_of(tank, 2, lose_thrust)
    details = [x.detail for x in audited(tank).findings if x.kind == "bad_cell"]
    assert len(details) == 1
    assert f"{len(rows)} of {len(rows)} cells of thrust_N are not finite numbers" in details[0]


UNREADABLE = {
    "empty": (b"", "empty"),
    "binary": (bytes(range(256)), "not_text"),
    "no header": (b"0.0,1,2,3,4,5\n0.1,1,2,3,4,5\n", "missing_column"),
    "two rows": (b"t_s,p_front_Pa\n0,1\n0.1,2\n", "few_rows"),
    "all torn": (b"t_s,p_front_Pa\n" + b"1\n" * 100, "bad_row"),
}


@pytest.mark.parametrize("name", UNREADABLE)
def test_an_unreadable_file_is_left_out(tank, name):
    content, kind = UNREADABLE[name]
    (tank / "trial_03.csv").write_bytes(content)
    found = audited(tank)
    out = [x for x in found.findings if x.action == "left out"]
    assert [(x.trial, x.kind) for x in out] == [("trial_03.csv", kind)]
    assert len(found.records) == 7


def test_a_missing_file_is_reported(tank):
    (tank / "trial_03.csv").unlink()
    found = audited(tank)
    only(found, 3, ("missing_file", None, "used"))
    assert len(found.records) == 7


def test_a_missing_column_is_reported_with_the_unknown_ones(tank):
    lines_of(tank, 3, lambda x: [x[0].replace("tip_m", "tip_mm"), *x[1:]])
    found = audited(tank)
    only(found, 3, ("missing_column", "tip_m", "used"))
    detail = found.findings[0].detail
    assert "tip_mm are ignored; rename tip_mm if it is tip_m" in detail
    assert "this sensor is not used" in detail


def test_semicolons_between_the_cells_are_named(tank):
    lines_of(tank, 3, lambda x: [line.replace(",", ";") for line in x])
    found = audited(tank)
    only(found, 3, ("missing_column", None, "left out"))
    assert "separate the cells with commas" in found.findings[0].detail


@pytest.mark.parametrize("number", [1, 6])
def test_a_copy_of_another_trial_is_left_out(tank, number):
    (tank / f"trial_{number:02d}.csv").write_bytes((tank / "trial_03.csv").read_bytes())
    found = audited(tank)
    out = {x.trial for x in found.findings if x.action == "left out"}
    assert out == {f"trial_{number:02d}.csv"}


def test_too_few_trials_are_refused_with_the_reasons(tank):
    for i in range(6):
        (tank / f"trial_{i:02d}.csv").write_text("hello")
    with pytest.raises(InputError) as caught:
        audited(tank)
    text = str(caught.value)
    assert "2 measured trials are usable, but at least 3 are needed" in text
    assert "trial_00.csv: the first line has no column t_s" in text and "\n" not in text


def test_the_refusal_names_missing_files(tank):
    for i in range(6):
        (tank / f"trial_{i:02d}.csv").unlink()
    with pytest.raises(InputError, match=r"no such file: trial_00\.csv, .*04\.csv and 1 more;"):
        audited(tank)


# Sensors


@pytest.mark.parametrize(("channel", "number"), [*zip(ROW, [0, 5, 7, 2, 4], strict=True)])
def test_readings_of_a_stuck_sensor_are_masked(tank, channel, number):
    row, a, b = ROW[channel], 160, 160 + (150 if channel == "tip" else 90)

    def stick(t, values):
        first = values[row, a:b][np.isfinite(values[row, a:b])][0]
        values[row, a:b] = np.where(np.isfinite(values[row, a:b]), first, np.nan)
        return t, values

    alter(tank, number, stick)
    found = audited(tank)
    only(found, number, ("stuck", channel, "masked"))
    r = record(found, number)
    assert np.isfinite(r.values[row, a + 8 : b - 1]).sum() == 0
    assert np.isfinite(r.values[row, :a]).sum() == len(
        range(0, a, damage.CAMERA_EVERY if channel == "tip" else 1)
    )


def test_a_sensor_that_is_constant_in_a_trial_is_masked_in_that_trial(tank):
    alter(tank, 2, lambda t, v: (t, np.where(np.arange(5)[:, None] == 3, 0.01, v)))
    found = audited(tank)
    only(found, 2, ("stuck", "recoil", "masked"))
    assert not record(found, 2).has("recoil") and record(found, 2).has("thrust")


@pytest.mark.parametrize(
    ("channel", "number", "share"),
    [("p_front", 0, 0.8), ("p_rear", 3, 0.7), ("thrust", 5, 0.6), ("recoil", 1, 0.5),
     ("recoil", 7, 0.8), ("tip", 0, 0.7)],
)  # fmt: skip
def test_clipped_readings_are_masked(tank, channel, number, share):
    row, ends = ROW[channel], []

    def clip(t, values):
        end = share * np.nanmax(np.abs(values[row]))
        end = round(end, {"tip": 5}.get(channel, 4))
        ends.append(end)
        values[row] = np.clip(values[row], -end, end)
        return t, values

    alter(tank, number, clip)
    found = audited(tank)
    assert kinds(found, number)[0] == ("clipped", channel, "masked")
    assert {x[0] for x in kinds(found)} <= {"clipped", "channel_lost", "doubled_rows"}
    left = record(found, number).values[row]
    assert not np.nanmax(np.abs(left), initial=0.0) >= ends[0] * (1.0 - 1e-9)


def test_a_saturated_pressure_with_noise_is_not_clipped():
    rng = np.random.default_rng(0)
    for level in np.linspace(200e3, 200e3 + damage.QUANTUM, 7):
        true = np.minimum(260e3 * np.abs(np.sin(np.arange(3000) / 200.0)), level)
        for noise in (20.0, 200.0, 700.0, 3000.0):
            read = damage.QUANTUM * np.round(
                (true + noise * rng.normal(size=3000)) / damage.QUANTUM
            )
            g = quantisation(read, noise)
            assert not clipped(read, g).any() and not stuck(read, g).any(), (level, noise)


def test_an_extreme_reading_that_is_rarer_than_its_neighbour_is_not_clipped():
    """Bounded noise has a largest reading too."""
    codes = np.repeat([-2.0, -1.0, 0.0, 1.0], [100, 300, 300, 100])
    shuffled = np.random.default_rng(0).permutation(codes)
    assert not clipped(shuffled, Quantisation(0.75, 1.0)).any()
    assert clipped(np.minimum(shuffled, 0.0), Quantisation(0.75, 1.0)).sum() >= 400


@pytest.mark.parametrize("width", [1, 2, 3])
def test_only_the_spikes_are_found(width):
    rng = np.random.default_rng(width)
    t = np.arange(2000) / 500.0
    values = 0.5 * np.sin(2 * np.pi * 3 * t) + 0.02 * rng.normal(size=2000)
    at = np.sort(rng.choice(np.arange(20, 1980, 20), 8, replace=False))
    broken = values.copy()
    for i in at:
        broken[i : i + width] += 8.0 * rng.choice([-1.0, 1.0])
    expected = np.zeros(2000, bool)
    for i in at:
        expected[i : i + width] = True
    np.testing.assert_array_equal(spikes(broken, quantisation(broken, 0.02)), expected)
    assert not spikes(values, quantisation(values, 0.02)).any()


def test_a_spike_in_a_file_is_reported_and_masked(tank):
    def spike(t, values):
        values[3, 333] = -40.0
        return t, values

    alter(tank, 6, spike)
    found = audited(tank)
    only(found, 6, ("spikes", "recoil", "masked"))
    assert np.flatnonzero(~np.isfinite(record(found, 6).values[3])).tolist() == [333]


# Outliers after the fit


def squares(trials, seed, worst=None, factor=1.0):
    rng = np.random.default_rng(seed)
    found = {c: 1.0 + 0.1 * rng.normal(size=len(trials)) ** 2 for c in ROW}
    if worst is not None:
        found["thrust"][worst] *= factor
    return found


@pytest.mark.parametrize("seed", range(4))
def test_only_a_far_larger_residual_than_the_other_trials_is_an_outlier(whole, seed):
    trials = experiment.load(whole / "experiment.toml").trials
    worst = seed + 2
    assert residual_outliers(trials, squares(trials, seed)) == []
    assert residual_outliers(trials, squares(trials, seed, worst, 20.0)) == []
    found = residual_outliers(trials, squares(trials, seed, worst, 300.0))
    assert [(x.trial, x.kind, x.channel) for x in found] == [
        (trials[worst].file, "outlier", "thrust")
    ]


def test_a_residual_that_follows_a_setting_is_no_outlier(whole):
    trials = experiment.load(whole / "experiment.toml").trials
    found = squares(trials, 0)
    found["recoil"] = np.array([t.frequency**7 for t in trials])
    found["thrust"] = np.array([200.0 if t.tow_speed else 1.0 for t in trials])
    assert residual_outliers(trials, found) == []
