"""The audit: every kind of damage is named and dealt with, and whole data give no finding."""

import re

import numpy as np
import pytest

from calibration.audit import audit
from calibration.audit_model import outliers
from calibration.audit_sensors import clipped, grain, spikes, stuck
from slider_jax import experiment
from slider_jax.errors import InputError
from tests import damage

ROW = {"p_front": 0, "p_rear": 1, "thrust": 2, "recoil": 3, "tip": 4}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return damage.write_experiment(tmp_path_factory.mktemp("whole")).parent


@pytest.fixture
def tank(whole, tmp_path):
    """A copy of the whole experiment, to be damaged."""
    for file in whole.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    return tmp_path


_QUIET: dict[str, tuple] = {}


def predict(records):
    """What a model with parameters that are a little off predicts."""
    found = []
    for r in records:
        if r.trial.file not in _QUIET:
            run = damage.RUNS[int(r.trial.file[6:8])]
            _QUIET[r.trial.file] = damage.quiet(run, gain=0.9, k=0.07)
        t, values = _QUIET[r.trial.file]
        found.append(np.stack([np.interp(r.t, t, y) for y in values]))
    return found


def audited(folder, least=3):
    return audit(experiment.load(folder / "experiment.toml"), least, predict)


def alter(folder, number, change):
    """Replace a trial's times and values by those that `change(t, values)` returns."""
    path = folder / f"trial_{number:02d}.csv"
    damage.save(path, *change(*damage.read(path)))


def lines_of(folder, number, change):
    path = folder / f"trial_{number:02d}.csv"
    path.write_text("\n".join(change(path.read_text().splitlines())) + "\n")


def kinds(found, number=None):
    name = None if number is None else f"trial_{number:02d}.csv"
    return [(x.kind, x.channel, x.action) for x in found.findings if name in (None, x.trial)]


def only(found, number, *expected):
    """Nothing but the expected findings, all on one trial."""
    assert kinds(found, number) == list(expected)
    assert len(found.findings) == len(expected), [str(x) for x in found.findings]


def record(found, number):
    return next(r for r in found.records if r.trial.file == f"trial_{number:02d}.csv")


def same_as_whole(found, whole, number, row=slice(None)):
    t, values = damage.read(whole / f"trial_{number:02d}.csv")
    r = record(found, number)
    np.testing.assert_allclose(r.t, t, atol=1e-5)
    np.testing.assert_allclose(r.values[row], values[row], rtol=1e-5)


# Whole data


def test_whole_data_give_no_finding(whole):
    found = audited(whole)
    assert [str(x) for x in found.findings] == []
    assert len(found.records) == 8
    same_as_whole(found, whole, 3)


@pytest.mark.parametrize(
    "physics", [{"delay": 0.03, "gain": 1.2}, {"k": 0.03}, {"k": 0.2, "gain": 0.8}]
)
def test_physics_that_all_trials_share_is_no_fault(tmp_path, physics):
    damage.write_experiment(tmp_path, 1, **physics)
    assert [str(x) for x in audited(tmp_path).findings] == []


@pytest.mark.parametrize("name", ["open_null", "open_delay", "open_clamp", "open_skin",
                                  "blind_a", "blind_b", "blind_c"])  # fmt: skip
def test_the_measured_sets_are_whole(data, name):
    found = audit(experiment.load(data / "sets" / name / "experiment.toml"))
    assert [str(x) for x in found.findings] == []
    assert len(found.records) == 8


# Rows and times


@pytest.mark.parametrize(("number", "first", "many"), [(0, 700, 40), (3, 200, 300), (7, 600, 7)])
def test_a_gap_is_named_and_stays_a_gap(tank, whole, number, first, many):
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
def test_rows_that_are_missing_at_an_end_are_named(tank, end):
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


def test_rows_that_repeat_the_one_before_under_new_times_are_masked(tank):
    def stale(t, values):
        values[:, 500:600:2] = values[:, 499:599:2]
        return t, values

    def camera(t, values):  # the repeated rows must not change where the camera has frames
        t, values = stale(t, values)
        values[4, 1::8] = np.nan
        return t, values

    alter(tank, 1, camera)
    found = audited(tank)
    assert ("doubled_rows", None, "masked") in kinds(found, 1)
    assert np.isnan(record(found, 1).values[2, 500:600:2]).all()
    assert len(found.records) == 8


def test_a_logger_that_stood_still_is_told_as_stuck(tank):
    def freeze(t, values):
        values[:, 400:450] = values[:, 400:401]
        return t, values

    alter(tank, 1, freeze)
    found = audited(tank)
    only(found, 1, ("stuck", None, "masked"))
    assert np.isnan(record(found, 1).values[:, 401:450]).all()


def test_rows_in_another_order_are_put_in_order(tank, whole):
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
def test_bad_rows_and_cells_are_named_and_the_rest_is_used(tank, name):
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


UNREADABLE = {
    "empty": (b"", "empty"),
    "binary": (bytes(range(256)), "not_text"),
    "no header": (b"0.0,1,2,3,4,5\n0.1,1,2,3,4,5\n", "missing_column"),
    "two rows": (b"t_s,p_front_Pa\n0,1\n0.1,2\n", "few_rows"),
    "all torn": (b"t_s,p_front_Pa\n" + b"1\n" * 100, "bad_row"),
}


@pytest.mark.parametrize("name", UNREADABLE)
def test_a_file_that_cannot_be_read_is_left_out(tank, name):
    content, kind = UNREADABLE[name]
    (tank / "trial_03.csv").write_bytes(content)
    found = audited(tank)
    out = [x for x in found.findings if x.action == "left out"]
    assert [(x.trial, x.kind) for x in out] == [("trial_03.csv", kind)]
    assert len(found.records) == 7


def test_a_file_that_is_not_there_is_told(tank):
    (tank / "trial_03.csv").unlink()
    found = audited(tank)
    only(found, 3, ("missing_file", None, "used"))
    assert len(found.records) == 7


def test_a_column_that_is_not_there_is_told(tank):
    lines_of(tank, 3, lambda x: [x[0].replace("tip_m", "tip_mm"), *x[1:]])
    found = audited(tank)
    only(found, 3, ("missing_column", "tip_m", "used"))
    assert "tip_mm" in found.findings[0].detail


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
    said = str(caught.value)
    assert "holds 2 measured trials that can be used; 3 or more are needed" in said
    assert "trial_00.csv: the first line names no column t_s" in said and "\n" not in said


# Sensors


@pytest.mark.parametrize(("channel", "number"), [*zip(ROW, [0, 5, 7, 2, 4], strict=True)])
def test_a_stuck_sensor_is_masked_while_it_is_stuck(tank, channel, number):
    row, a, b = ROW[channel], 320, 320 + (150 if channel == "tip" else 90)

    def stick(t, values):
        first = values[row, a:b][np.isfinite(values[row, a:b])][0]
        values[row, a:b] = np.where(np.isfinite(values[row, a:b]), first, np.nan)
        return t, values

    alter(tank, number, stick)
    found = audited(tank)
    only(found, number, ("stuck", channel, "masked"))
    r = record(found, number)
    assert np.isfinite(r.values[row, a + 8 : b - 1]).sum() == 0
    assert np.isfinite(r.values[row, :a]).sum() == len(range(0, a, 8 if channel == "tip" else 1))


def test_a_sensor_that_is_dead_in_a_trial_is_not_used_there(tank):
    alter(tank, 2, lambda t, v: (t, np.where(np.arange(5)[:, None] == 3, 0.01, v)))
    found = audited(tank)
    only(found, 2, ("stuck", "recoil", "masked"))
    assert not record(found, 2).has("recoil") and record(found, 2).has("thrust")


@pytest.mark.parametrize(
    ("channel", "number", "share"),
    [("p_front", 0, 0.8), ("p_rear", 3, 0.7), ("thrust", 5, 0.6), ("recoil", 1, 0.5),
     ("recoil", 7, 0.8), ("tip", 0, 0.7)],
)  # fmt: skip
def test_a_clipped_sensor_is_masked_where_it_is_clipped(tank, channel, number, share):
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


def test_a_pressure_that_saturates_is_no_clipped_sensor():
    rng = np.random.default_rng(0)
    for level in np.linspace(200e3, 200e3 + damage.QUANTUM, 7):
        true = np.minimum(260e3 * np.abs(np.sin(np.arange(3000) / 200.0)), level)
        for noise in (20.0, 200.0, 700.0, 3000.0):
            read = damage.QUANTUM * np.round(
                (true + noise * rng.normal(size=3000)) / damage.QUANTUM
            )
            g = grain(read, noise)
            assert not clipped(read, g).any() and not stuck(read, g).any(), (level, noise)


@pytest.mark.parametrize("width", [1, 2, 3])
def test_spikes_are_masked_and_nothing_else(width):
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
    np.testing.assert_array_equal(spikes(broken, grain(broken, 0.02)), expected)
    assert not spikes(values, grain(values, 0.02)).any()


def test_a_spike_in_a_file_is_named(tank):
    def spike(t, values):
        values[3, 333] = -40.0
        return t, values

    alter(tank, 6, spike)
    found = audited(tank)
    only(found, 6, ("spikes", "recoil", "masked"))
    assert np.flatnonzero(~np.isfinite(record(found, 6).values[3])).tolist() == [333]


# Units, signs, columns

UNITS = [
    ("p_front", 1e-3, "kPa"), ("p_rear", 1e3, "mPa"), ("p_front", 1 / 6894.757, "psi"),
    ("thrust", 1e3, "mN"), ("recoil", 1e3, "mN"), ("recoil", 1e-3, "kN"), ("tip", 1e3, "mm"),
]  # fmt: skip


@pytest.mark.parametrize("which", ["one", "all"])
@pytest.mark.parametrize(("channel", "factor", "unit"), UNITS)
def test_wrong_units_are_mended(tank, whole, channel, factor, unit, which):
    numbers = range(8) if which == "all" else [4]
    for i in numbers:
        scale = np.where(np.arange(5) == ROW[channel], factor, 1.0)[:, None]
        alter(tank, i, lambda t, v, scale=scale: (t, v * scale))
    found = audited(tank)
    assert kinds(found) == [("units", channel, "mended")] * len(numbers)
    assert all(unit in x.detail for x in found.findings)
    for i in numbers:
        same_as_whole(found, whole, i, ROW[channel])


def test_both_forces_in_millinewton_everywhere_are_mended(tank, whole):
    for i in range(8):
        alter(tank, i, lambda t, v: (t, v * np.array([1, 1, 1e3, 1e3, 1])[:, None]))
    found = audited(tank)
    assert len(found.findings) == 16 and {x.kind for x in found.findings} == {"units"}
    same_as_whole(found, whole, 3)


@pytest.mark.parametrize("which", ["one", "all"])
def test_times_in_milliseconds_are_mended(tank, whole, which):
    numbers = range(8) if which == "all" else [4]
    for i in numbers:
        alter(tank, i, lambda t, v: (1e3 * t, v))
    found = audited(tank)
    assert kinds(found) == [("units", "t_s", "mended")] * len(numbers)
    same_as_whole(found, whole, 4)


@pytest.mark.parametrize("channel", ["p_front", "thrust", "recoil", "tip"])
def test_a_turned_sign_is_mended(tank, whole, channel):
    sign = np.where(np.arange(5) == ROW[channel], -1.0, 1.0)[:, None]
    alter(tank, 1, lambda t, v: (t, v * sign))
    found = audited(tank)
    only(found, 1, ("sign", channel, "mended"))
    same_as_whole(found, whole, 1)


PAIRS = [(0, 1), (2, 3), (0, 2), (1, 3), (1, 4), (3, 4)]


@pytest.mark.parametrize("which", ["one", "all"])
@pytest.mark.parametrize("pair", PAIRS)
def test_swapped_columns_are_put_back(tank, whole, pair, which):
    numbers = {"one": [3 + sum(pair) % 4], "all": range(8)}[which]
    order = np.arange(5)
    order[list(pair)] = pair[::-1]
    for i in numbers:
        alter(tank, i, lambda t, v: (t, v[order]))
    found = audited(tank)
    swapped = [x for x in found.findings if x.kind == "swapped_columns"]
    assert [x.trial for x in swapped] == [f"trial_{i:02d}.csv" for i in numbers]
    assert len(found.findings) == len(swapped), [str(x) for x in found.findings]
    for i in numbers:
        same_as_whole(found, whole, i)


# Clocks and settings


@pytest.mark.parametrize(("off", "number"), [(-0.02, 0), (-0.006, 4), (0.006, 7), (0.025, 1)])
def test_a_skewed_clock_whose_rate_shows_it_is_mended(tank, whole, off, number):
    alter(tank, number, lambda t, v: (t * (1.0 + off), v))
    found = audited(tank)
    only(found, number, ("clock_skew", "t_s", "mended"))
    same_as_whole(found, whole, number)


def test_a_skewed_clock_that_nothing_else_shows_is_left_out(tank):
    def drift(t, values):  # the logger believes in its even rate
        late = np.interp(t, 1.01 * t, t)
        for row in range(4):
            values[row] = np.interp(late, t, values[row])
        return t, values

    alter(tank, 4, drift)
    found = audited(tank)
    only(found, 4, ("clock_skew", "t_s", "left out"))


def test_a_clock_that_is_skewed_in_all_trials_is_mended(tank, whole):
    for i in range(8):
        alter(tank, i, lambda t, v: (1.02 * t, v))
    found = audited(tank)
    assert kinds(found) == [("clock_skew", "t_s", "mended")] * 8
    same_as_whole(found, whole, 5)


@pytest.mark.parametrize("off", [0.04, -0.05, 0.15])
def test_times_that_are_offset_are_left_out(tank, off):
    alter(tank, 3, lambda t, v: (t[t + off >= 0.0] + off, v[:, t + off >= 0.0]))
    found = audited(tank)
    assert ("time_offset", "t_s", "left out") in kinds(found, 3)
    assert len(found.records) == 7


def test_an_offset_of_a_few_milliseconds_is_no_fault(tank):
    alter(tank, 3, lambda t, v: (t[:-3] + 0.004, v[:, :-3]))
    assert kinds(audited(tank)) == []


def test_exchanged_files_are_left_out_and_the_other_is_named(tank):
    a, b = tank / "trial_03.csv", tank / "trial_05.csv"
    first, second = a.read_bytes(), b.read_bytes()
    a.write_bytes(second)
    b.write_bytes(first)
    found = audited(tank)
    out = {x.trial: x for x in found.findings if x.action == "left out"}
    assert set(out) == {"trial_03.csv", "trial_05.csv"}
    assert "trial_05.csv" in out["trial_03.csv"].detail
    assert len(found.records) == 6


@pytest.mark.parametrize(
    ("number", "changes", "kind"),
    [(3, {"frequency": 2.5}, "wrong_drive"), (3, {"frequency": 2.24}, "clock_skew"),
     (4, {"phase": 0.3}, "wrong_phase"), (6, {"phase": 0.15}, "wrong_phase"),
     (2, {"amplitude": 250e3}, "wrong_amplitude"), (5, {"amplitude": 150e3}, "wrong_amplitude")],
)  # fmt: skip
def test_settings_that_were_not_run_are_named(tank, number, changes, kind):
    loaded = experiment.load(tank / "experiment.toml")
    wrong = loaded.with_values({f"trials.{number}.{key}": x for key, x in changes.items()})
    found = audit(wrong, 3, predict)
    out = [(x.trial, x.kind) for x in found.findings if x.action == "left out"]
    assert out == [(f"trial_{number:02d}.csv", kind)]


@pytest.mark.parametrize("seed", range(3))
def test_one_corrupt_trial_among_eight_is_left_out(tank, seed):
    rng = np.random.default_rng(seed)
    number = int(rng.integers(8))
    size = np.array([2e5, 2e5, 0.3, 0.5, 0.03])[:, None]
    alter(tank, number, lambda t, v: (t, np.round(size * rng.normal(size=v.shape), 4)))
    found = audited(tank)
    out = [(x.trial, x.kind) for x in found.findings if x.action == "left out"]
    assert out == [(f"trial_{number:02d}.csv", "wrong_drive")]
    assert len(found.records) == 7


def test_a_force_that_resembles_nothing_is_masked(tank):
    rng = np.random.default_rng(1)

    def noise(t, values):
        values[3] = np.round(0.4 * rng.normal(size=len(t)), 4)
        return t, values

    alter(tank, 4, noise)
    found = audited(tank)
    only(found, 4, ("strange_channel", "recoil", "masked"))
    assert not record(found, 4).has("recoil")


def test_another_rate_is_told_and_used(tank):
    lines_of(tank, 4, lambda x: [x[0], *x[1::2]])
    found = audited(tank)
    only(found, 4, ("sample_rate", "t_s", "used"))
    lines_of(tank, 5, lambda x: [x[0], *x[1:250], *x[250::2]])
    assert ("sample_rate", None, "used") in kinds(audited(tank), 5)


# Trials that stand apart after the fit


def squares(trials, seed, worst=None, factor=1.0):
    rng = np.random.default_rng(seed)
    found = {c: 1.0 + 0.1 * rng.normal(size=len(trials)) ** 2 for c in ROW}
    if worst is not None:
        found["thrust"][worst] *= factor
    return found


@pytest.mark.parametrize("seed", range(4))
def test_a_trial_that_no_fit_explains_is_an_outlier(whole, seed):
    trials = experiment.load(whole / "experiment.toml").trials
    worst = seed + 2
    assert outliers(trials, squares(trials, seed)) == []
    assert outliers(trials, squares(trials, seed, worst, 20.0)) == []
    found = outliers(trials, squares(trials, seed, worst, 300.0))
    assert [(x.trial, x.kind, x.channel) for x in found] == [
        (trials[worst].file, "outlier", "thrust")
    ]


def test_what_grows_with_a_setting_is_no_outlier(whole):
    trials = experiment.load(whole / "experiment.toml").trials
    found = squares(trials, 0)
    found["recoil"] = np.array([1.0 + 40.0 * t.frequency**2 for t in trials])
    found["thrust"] = np.array([200.0 if t.tow_speed else 1.0 for t in trials])
    assert outliers(trials, found) == []
