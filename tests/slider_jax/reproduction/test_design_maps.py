"""The paper's design maps: findings in synthetic maps."""

import re

import numpy as np
import pytest

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
    assert [x.agrees for x in found] == [True] * 7
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
    ("best", "agrees"), [(0.12, [True, True]), (0.21, [False, True]), (-0.1, [False, False])]
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
    assert [x.agrees for x in slice_of_phase(at_60)] == [None, True]


@pytest.mark.draws
def test_maps_with_gaps_are_drawn(tmp_path):
    holes = without(without(PAPERS, 0, 3), 2, 4)
    plot_design_maps(over_stiffness(0.003), holes, "made up", tmp_path / "map.png")
    assert (tmp_path / "map.png").stat().st_size > 20_000
