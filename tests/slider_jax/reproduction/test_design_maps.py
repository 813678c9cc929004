"""The paper's design maps: findings in synthetic maps, and the script with a coarse swimmer."""

import json
import re
import runpy

import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.errors import InputError
from slider_jax.experiment.load import assemble, load, to_model, to_numerics
from slider_jax.optimise.design_space import to_toml
from slider_jax.reproduction.design_findings import (
    findings,
    half_is_poor,
    interior_optimum,
    long_tails_gain_less,
    negative_is_slower,
    short_tails_phase,
    slice_of_phase,
)
from slider_jax.reproduction.design_maps import Map, best_phase, best_stiffness, curve_maximum
from slider_jax.reproduction.design_maps_report import plot_design_maps
from slider_jax.sweep import sweep as sweeping
from slider_jax.swimming.gait import to_swimmer as free
from slider_jax.swimming.paper_optimum import swimmer_content
from slider_jax.swimming.steady_state import SteadySettings, find_steady
from tests.support.data import ROOT

SCRIPT = ROOT / "scripts" / "fig7_design_maps.py"
script = runpy.run_path(str(SCRIPT))
main = script["main"]

LENGTHS = np.array([0.02, 0.04, 0.06, 0.08, 0.10])
PHASES = np.linspace(-0.5, 0.5, 21)
STIFFNESS = np.geomspace(1e-4, 1e-1, 13)


def over_phase(best, height=0.3, curvature=2.0):
    """Returns a parabola over phase for each length; a scalar is used for all lengths."""
    best, height, curvature = (
        np.broadcast_to(x, LENGTHS.shape)[:, None] for x in (best, height, curvature)
    )
    return Map(LENGTHS, PHASES, height - curvature * (PHASES - best) ** 2)


def over_stiffness(best):
    """Returns a parabola over the logarithm of the stiffness with its maximum at `best` [N m^2]."""
    best = np.broadcast_to(best, LENGTHS.shape)[:, None]
    return Map(LENGTHS, STIFFNESS, 0.3 - 0.02 * np.log(STIFFNESS / best) ** 2)


PAPERS = over_phase(0.15, curvature=np.array([6.0, 5.0, 4.0, 3.0, 2.0]))
"""A map that agrees with all of the paper's statements on phase."""


def without(drawn, row, column):
    speed = drawn.speed.copy()
    speed[row, column] = np.nan
    return drawn._replace(speed=speed)


def test_the_maximum_of_a_parabola_is_exact_between_points():
    x = np.array([0.0, 0.1, 0.25, 0.3, 0.5])
    found = curve_maximum(x, 2.0 - 3.0 * (x - 0.22) ** 2)
    assert found.x == pytest.approx(0.22) and found.y == pytest.approx(2.0) and found.inside


@pytest.mark.parametrize(
    ("y", "x", "inside"),
    [
        ([1.0, 2.0, 3.0], 2.0, False),
        ([3.0, 2.0, 1.0], 0.0, False),
        ([1.0, 1.0, 1.0], 0.0, False),
        ([1.0, 3.0, np.nan], 1.0, None),
        ([np.nan, 3.0, 1.0], 1.0, None),
        ([np.nan, np.nan, np.nan], np.nan, None),
    ],
)
def test_a_maximum_at_an_end_or_beside_a_gap_is_not_interpolated(y, x, inside):
    found = curve_maximum(np.arange(3.0), np.array(y))
    assert found.x == pytest.approx(x, nan_ok=True) and found.inside is inside


def test_best_stiffness_and_phase_are_found_at_every_length():
    stiff, late = LENGTHS**2, LENGTHS + 0.1
    np.testing.assert_allclose([p.x for p in best_stiffness(over_stiffness(stiff))], stiff)
    np.testing.assert_allclose([p.x for p in best_phase(over_phase(late))], late)


def test_a_map_like_the_papers_agrees_with_all_statements():
    found = findings(over_stiffness(0.003), PAPERS)
    assert [x.agrees for x in found] == [True] * 8
    assert {x.verdict for x in found} == {"agrees"}


FALSE = [
    (interior_optimum, over_stiffness([0.003, 0.003, 0.5, 0.003, 1e-6]), "60, 100 mm"),
    (
        short_tails_phase,
        over_phase([0.15, 0.15, 0.22, 0.4, 0.4]),
        r"\+0.070 overall; too large for 60",
    ),
    (negative_is_slower, over_phase([0.1, 0.1, 0.1, 0.1, -0.06]), "-.* at 100 mm"),
    (half_is_poor, over_phase([0.15, 0.15, 0.35, 0.15, 0.15]), "25.5 overall, compared with"),
    (
        long_tails_gain_less,
        over_phase(0.15, curvature=np.arange(1.0, 6.0)),
        "10.1 compared with 4.5",
    ),
]


@pytest.mark.parametrize(("finding", "drawn", "content"), FALSE)
def test_a_false_statement_is_reported_with_its_values(finding, drawn, content):
    found = finding(drawn)
    assert found.agrees is False and found.verdict == "does not agree"
    assert re.search(content, found.measured), found.measured


@pytest.mark.parametrize(
    ("best", "agrees"),
    [(0.12, [True, True, True]), (0.21, [False, True, True]), (0.07, [False, False, True])]
    + [(-0.1, [False, False, False])],
)
def test_the_slice_uses_only_the_tail_of_60_mm(best, agrees):
    others = np.array([0.4, 0.4, best, 0.4, 0.4])
    assert [x.agrees for x in slice_of_phase(over_phase(others))] == agrees


def test_swimming_tail_first_is_slower_than_standing_still():
    backwards = PAPERS.speed.copy()
    backwards[:, PHASES < -0.01] = -9.0
    assert negative_is_slower(PAPERS._replace(speed=backwards)).agrees


def test_missing_speeds_are_listed_and_the_other_speeds_decide():
    zero, fifth, half = (int(np.argmin(np.abs(PHASES - x))) for x in (0.0, 0.2, 0.5))
    gap = half_is_poor(without(PAPERS, 1, half))
    assert gap.agrees and "missing for 40 mm" in gap.measured
    assert negative_is_slower(without(PAPERS, 1, zero)).agrees
    assert short_tails_phase(without(PAPERS, 1, fifth)).agrees
    backwards = over_phase([0.15, 0.15, 0.35, 0.15, 0.15])
    assert half_is_poor(without(backwards, 1, half)).agrees is False
    stiff = over_stiffness(0.003)
    beside = int(np.argmax(stiff.speed[2])) + 1
    found = interior_optimum(without(stiff, 2, beside))
    assert found.agrees and "missing for 60 mm" in found.measured


def test_a_statement_without_speeds_is_not_decided():
    nothing = PAPERS._replace(speed=np.full_like(PAPERS.speed, np.nan))
    found = findings(nothing._replace(across=STIFFNESS, speed=nothing.speed[:, :13]), nothing)
    assert {x.verdict for x in found} == {"not decided"}
    at_60 = without(PAPERS, 2, int(np.argmin(np.abs(PHASES - 0.2))))
    assert [x.agrees for x in slice_of_phase(at_60)] == [None, None, True]


@pytest.mark.draws
def test_maps_with_gaps_are_drawn(tmp_path):
    holes = without(without(PAPERS, 0, 3), 2, 4)
    plot_design_maps(over_stiffness(0.003), holes, "made up", tmp_path / "map.png")
    assert (tmp_path / "map.png").stat().st_size > 20_000


@pytest.fixture
def swimmer(tmp_path):
    content = swimmer_content(frequency=5.0, amplitude=365e3, phase=0.2)
    coarse = content | {"numerics": {"nodes": 17, "step": 0.004}}
    path = tmp_path / "swimmer.toml"
    path.write_text(to_toml(assemble(coarse, "coarse", tmp_path)))
    return path


def test_the_axes_include_the_shown_slices_for_any_number_of_points(swimmer):
    task = script["sweeps"](load(swimmer), 4)
    lengths, phases = (axis.values for axis in task["b"].axes)
    assert {0.02, 0.04, 0.06, 0.08, 0.1} < set(lengths) and {0.0, 0.2, 0.5} < set(phases)
    assert np.all(np.diff(lengths) > 1e-6) and np.all(np.diff(phases) > 1e-6)


@pytest.mark.parametrize("points", ["3", "2", "-1"])
def test_too_few_points_are_refused_without_output(swimmer, tmp_path, points):
    with pytest.raises(InputError, match=f"--points: given {points}; allowed 4 or more"):
        main([str(tmp_path / "out"), "--points", points, "--swimmer", str(swimmer)])
    assert not (tmp_path / "out").exists()


def test_a_missing_swimmer_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="no_such.toml"):
        main([str(tmp_path / "out"), "--swimmer", str(tmp_path / "no_such.toml")])
    assert not (tmp_path / "out").exists()


def made_up_table(batch, _):
    """Replaces the simulation by the parabola over phase of `PAPERS`."""
    model = batch.model
    bend = 0.1 / np.asarray(model.robot.tail.lengths)
    return {"speed_m_per_s": 0.3 - bend * (np.asarray(model.drive.waves[1].phase) - 0.15) ** 2}


@pytest.mark.slow
def test_an_interrupted_script_resumes_and_writes_all_files(swimmer, tmp_path, capsys, monkeypatch):
    out, calls, stopping = tmp_path / "out", [], [True]
    command = [str(out), "--points", "4", "--swimmer", str(swimmer)]

    def stopped_at_the_second(*args):
        calls.append(1)
        if len(calls) > 1 and stopping:
            raise KeyboardInterrupt
        return made_up_table(*args)

    monkeypatch.setattr(sweeping, "available_cores", lambda: 1)
    monkeypatch.setattr(sweeping, "swim_performance", lambda plan, batch: (batch, None))
    monkeypatch.setattr(sweeping, "performance_table", stopped_at_the_second)
    with pytest.raises(KeyboardInterrupt):
        main(command)
    assert [p.name for p in out.iterdir()] == ["map_a"]
    assert len(list((out / "map_a" / "partial").glob("chunk*"))) == 1

    stopping.clear()
    assert main(command) == 0
    assert "map a: 1 of 4 parts" in capsys.readouterr().err
    assert sorted(p.name for p in out.iterdir()) == ["fig7.json", "fig7.png", "fig7.txt"]
    content = json.loads((out / "fig7.json").read_text())
    assert np.shape(content["map_a"]["speed_m_per_s"]) == (7, 4)
    phases, speed = (np.array(content["map_b"][name]) for name in ("phase", "speed_m_per_s"))
    np.testing.assert_array_equal(phases, np.round([-0.5, -1 / 6, 0.0, 1 / 6, 0.2, 0.5], 9))
    np.testing.assert_allclose(speed[6], 0.3 - (phases - 0.15) ** 2)
    assert (
        len(content["findings"]) == 8 and content["versions"]["jax"] and content["input"]["sha256"]
    )
    text = (out / "fig7.txt").read_text()
    assert "1. there is a best stiffness for every tail length: does not agree" in text
    assert "3. negative phase is slower: agrees" in text


@pytest.mark.slow
def test_the_scripts_speeds_equal_those_of_single_swimmers(swimmer, tmp_path):
    out = tmp_path / "out"
    assert main([str(out), "--points", "4", "--swimmer", str(swimmer)]) == 0
    content = json.loads((out / "fig7.json").read_text())["map_b"]
    speed = np.array(content["speed_m_per_s"], float)
    np.testing.assert_allclose(speed[:, 0], speed[:, -1], atol=1e-3)  # -0.5 is 0.5 again
    given = load(swimmer)
    phase = content["phase"].index(0.2)
    long = given.with_values({"robot.tail_length": content["tail_length_m"][3]})
    search = SteadySettings(steps_per_stride=100, numerics=to_numerics(given)[0])
    alone = find_steady(free(to_model(long, 0)), jnp.asarray(5.0), search)
    assert speed[3, phase] == pytest.approx(float(alone.speed), rel=1e-4)
