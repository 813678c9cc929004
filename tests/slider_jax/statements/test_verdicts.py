"""Verdicts on the statements, the searches' summary, and the page."""

import json

import numpy as np
import pytest

from calibration.reporting.statements import statement_tables, statements_page, statements_summary
from slider_jax.optimise.loop import OptimisationResult
from slider_jax.statements.assumptions import RANGES, Assumptions, to_unit
from slider_jax.statements.joint_fit import (
    ALL,
    COUNTED,
    OBJECTIVES,
    Ascent,
    Effort,
    Simulator,
    Slopes,
    agreement_score,
    ascend,
    ascent_record,
    front,
    misses,
    search,
    summary,
    witness,
)
from slider_jax.statements.multimodal import FIG_9, OF_FRONT, judged_front
from slider_jax.statements.quantities import COARSE, FINE
from slider_jax.statements.statements import (
    ASSUMED,
    FAILED,
    INCONSISTENT,
    MISSED,
    OMITTED,
    REPRODUCED,
    SIMULATED,
    TOLERANCES,
)
from slider_jax.statements.verdicts import (
    Evidence,
    counts,
    fitted_assumptions,
    joint_fit,
    judged,
    judged_optimum,
    summary_sentence,
)
from slider_jax.swimming.paper_optimum import PAPER_GAIT


def agreeing_facts(**changed):
    """Facts with which all statements agree, except those that are `changed`."""
    found = {}
    for one in SIMULATED.values():
        middle = one.published
        found[one.fact] = middle if middle is not None else max(one.low, min(one.high, 0.0))
    return found | changed


def evidence(built_in, fitted, reverted=None, changed=(), witness=None):
    witnesses = dict.fromkeys(SIMULATED, (Assumptions(k=0.02), witness or fitted))
    return Evidence(built_in, fitted, reverted or {}, list(changed), witnesses)


def verdict_of(name, x):
    return next(one for one in judged(x) if one.name == name)


def test_a_statement_that_the_built_in_robot_meets_is_reproduced():
    x = evidence(agreeing_facts(), agreeing_facts())
    assert {verdict_of(name, x).verdict for name in SIMULATED} == {REPRODUCED}
    assert verdict_of("time_per_step", x).verdict == INCONSISTENT
    assert sum(counts(judged(x)).values()) == len(judged(x))


def test_the_necessary_assumptions_and_the_sufficient_changes_are_named():
    slow = agreeing_facts(speed_m_per_s=0.1)
    x = evidence(
        slow,
        agreeing_facts(),
        reverted={"K_Q": slow, "k": agreeing_facts()},
        changed=[("head_drag", 1e-2, agreeing_facts()), ("head_drag", 5e-3, agreeing_facts()),
                 ("phase", 0.2, slow)],
    )  # fmt: skip
    found = verdict_of("speed", x)
    assert found.verdict == ASSUMED
    assert "not if one of these returns: K_Q;" in found.why
    assert "enough: head_drag = 0.005 m^2" in found.why


def test_a_statement_is_missed_only_if_no_simulated_set_meets_it():
    slow, good = agreeing_facts(speed_m_per_s=0.1), agreeing_facts()
    assert verdict_of("speed", evidence(slow, slow, witness=slow)).verdict == MISSED
    other = verdict_of("speed", evidence(slow, slow, witness=good))
    assert other.verdict == ASSUMED and "k = 0.02" in other.why
    alone = evidence(slow, slow, changed=[("k", 0.05, good)], witness=slow)
    assert verdict_of("speed", alone).verdict == ASSUMED
    lost = agreeing_facts(speed_m_per_s=np.nan)
    assert verdict_of("speed", evidence(lost, lost, witness=lost)).verdict == FAILED


def test_the_optimum_agrees_within_a_tenth():
    near, far = PAPER_GAIT._replace(frequency=6.8), PAPER_GAIT._replace(frequency=4.5)
    found = {x.name: x for x in judged_optimum([(far, 0.5), (near, 0.24)], 0.232)}
    assert found["optimum_frequency"].verdict == found["optimum_speed"].verdict == ASSUMED
    assert found["optimum_phase"].verdict == REPRODUCED
    assert found["optimum_tail_length"].built_in == pytest.approx(53.0)


def test_the_score_counts_only_the_statements_of_its_objective():
    wrong = agreeing_facts(speed_m_per_s=1.0)
    assert agreement_score(agreeing_facts(), OBJECTIVES[ALL]) == 0.0
    assert (
        agreement_score(wrong, OBJECTIVES["swimming"])
        < agreement_score(wrong, OBJECTIVES[ALL])
        < 0.0
    )
    assert agreement_score(wrong, OBJECTIVES["head fixed"]) == 0.0
    assert set(OBJECTIVES["swimming"]) | set(OBJECTIVES["head fixed"]) == set(OBJECTIVES[ALL])
    assert OBJECTIVES[ALL] == COUNTED
    assert {"tail_amplitude_measured", "wavelength_measured"} <= set(SIMULATED) - set(COUNTED)


def test_the_front_contains_no_set_that_another_surpasses():
    def row(thrust, amplitude):
        return agreeing_facts(sweep_peak_N=thrust, tail_amplitude_m=amplitude,
                              sweep_peak_Hz=4.8, speed_m_per_s=0.2)  # fmt: skip

    points = np.linspace(0.1, 0.9, 4)[:, None] * np.ones(len(RANGES))
    rows = [row(0.060, 0.020), row(0.120, 0.036), row(0.09, 0.03), row(0.12, 0.03)]
    found = front({tuple(p): r for p, r in zip(points.tolist(), rows, strict=True)})
    thrusts = [x["facts"]["sweep_peak_N"] for x in found]
    assert thrusts == [0.060, 0.09, 0.12]
    assert found[-1]["facts"]["tail_amplitude_m"] == 0.036


def test_the_witness_agrees_and_has_the_best_score():
    far = agreeing_facts(strouhal=9.0, speed_m_per_s=0.5)  # a statement that does not count
    near = agreeing_facts(speed_m_per_s=0.2)
    rows = {(0.1,): far, (0.2,): near, (0.3,): agreeing_facts(tail_amplitude_m=0.01)}
    assert witness("tail_amplitude", rows) == (0.2,)
    assert witness("speed", rows) == (0.3,)
    del rows[(0.3,)]
    assert witness("speed", rows) == (0.2,)  # none agrees; this one misses least


class Bowl:
    """In place of the simulation: facts that agree best at 0.3 in the unit box."""

    at = COARSE

    def __init__(self):
        self.rows = []

    def __call__(self, points):
        found = [agreeing_facts(speed_m_per_s=0.232 * (1.0 + np.abs(x - 0.3).sum()))
                 for x in points]  # fmt: skip
        self.rows += [{"point": p.tolist(), "facts": f} for p, f in zip(points, found, strict=True)]
        return found


def test_a_search_resumes_and_its_summary_has_the_best_set(tmp_path):
    effort, bowl = Effort(population=8, generations=6), Bowl()
    search(bowl, ALL, 0, Effort(population=8, generations=3), tmp_path / "a")
    found = search(bowl, ALL, 0, effort, tmp_path / "a")
    whole = search(Bowl(), ALL, 0, effort, tmp_path / "b")
    assert isinstance(found, OptimisationResult) and found.score == whole.score
    (facts,) = Bowl()(found.best[None])
    better = np.clip(found.best, 0.1, 0.9)
    refined = ascent_record(ALL, 0, Ascent(better, [-0.2, -0.1], facts, facts))
    content = summary([(ALL, 0, found)], refined, bowl.rows, effort)
    (record,) = content["searches"]
    assert content["evaluated"] == 6 * 8 and record["score"] == found.score
    assert to_unit(fitted_assumptions(content)) == pytest.approx(better)
    assert content["refined"]["agree"] == content["refined"]["agree_before"] == record["agree"]
    assert content["refined"]["score"] == -0.1 and content["refined"]["steps"] == 1


def test_gradient_steps_reach_the_best_set_within_the_ranges():
    """Misses that are linear in the unit box, with the best set at 0.3, and at 0 for the first."""
    best = np.r_[-0.2, np.full(len(RANGES) - 1, 0.3)]

    def missed(point):
        return np.resize(0.5 * (point - best), len(COUNTED))

    def simulate(points):
        # A miss of 1 is half of the interval of the statement.
        rows = []
        for x in points:
            rows.append({})
            for name, miss in zip(COUNTED, missed(x), strict=True):
                one = SIMULATED[name]
                half = 0.5 * (one.high - one.low) if one.published is not None else 0.0
                rows[-1][one.fact] = (one.published or 0.0) + miss * half
                if one.published is None:
                    rows[-1][one.fact] = max(one.low, min(one.high, 0.0))
        return rows

    two_sided = tuple(name for name in COUNTED if SIMULATED[name].published is not None)

    def slopes(point, counted):
        places = [COUNTED.index(name) for name in counted]
        matrix = np.zeros((len(COUNTED), len(RANGES)))
        matrix[np.arange(len(COUNTED)), np.arange(len(COUNTED)) % len(RANGES)] = 0.5
        signs = np.sign(missed(point))
        return np.abs(missed(point))[places], (signs[:, None] * matrix)[places]

    start = np.full(len(RANGES), 0.6)
    found = ascend(slopes, simulate, start, two_sided, 12)
    moved = {COUNTED.index(name) % len(RANGES) for name in two_sided}
    expected = np.clip(best, 0.0, 1.0)
    for i in range(len(RANGES)):
        assert found.point[i] == pytest.approx(expected[i] if i in moved else 0.6, abs=5e-3), i
    assert found.scores == sorted(found.scores) and len(found.scores) > 2
    assert found.scores[-1] == agreement_score(found.last, two_sided)
    none = ascend(slopes, simulate, found.point, two_sided, 3)
    assert len(none.scores) <= 2


@pytest.mark.slow
def test_the_slopes_of_the_misses_equal_differences():
    point = to_unit(fitted_assumptions(joint_fit()))
    smooth = (
        "static_tip",
        "sweep_peak",
        "speed",
        "tail_amplitude",
        "wavelength",
        "best_phase_speed",
    )
    missed, slope = Slopes(COARSE)(point, smooth)
    simulate, step = Simulator(COARSE), 1e-4
    names = list(RANGES)
    moved = [names.index(name) for name in ("K_Q", "EI_body", "k", "head_drag")]
    points = [point + side * step * np.eye(len(names))[i] for i in moved for side in (1, -1)]
    found = [misses(x, smooth) for x in simulate(np.array(points))]
    for column, i in enumerate(moved):
        differences = (found[2 * column] - found[2 * column + 1]) / (2.0 * step)
        np.testing.assert_allclose(slope[:, i], differences, rtol=2e-3, atol=2e-3)
    assert missed == pytest.approx(misses(simulate(point[None])[0], smooth))


def test_the_stored_searches_belong_to_the_present_statements_and_ranges():
    found = joint_fit()
    assert set(found["agreeing"]) == set(found["witnesses"]) == set(SIMULATED)
    assert list(Assumptions().values()) == list(RANGES) == list(vars(Assumptions()))
    for name, one in RANGES.items():
        assert found["ranges"][name] == [one.low, one.high, one.log], name
    done = [(x["objective"], x["start"]) for x in found["searches"]]
    assert found["effort"] == Effort()._asdict() and done == Effort().searches()


def record_of(judgements):
    """A published.json with few values."""
    robots = {name: {k: 1.0 for k in RANGES} for name in ("built-in robot", "joint assumptions")}
    facts = {"sweep_peak_N": 0.06, "sweep_peak_Hz": 4.8, "tail_amplitude_m": 0.036,
             "speed_m_per_s": 0.232}  # fmt: skip
    return {
        "said": summary_sentence(judgements),
        "statements": [x._asdict() for x in judgements],
        "counts": counts(judgements),
        "tolerances": TOLERANCES,
        "evaluated": 10,
        "settings": {"assumptions": robots},
        "ranges": {name: x._asdict() for name, x in RANGES.items()},
        "optimum": {"paper": {"gait": PAPER_GAIT._asdict(), "speed_m_per_s": 0.232}},
        "wavelengths_m": {name: {"phase": 0.3, "shape": 0.28} for name in robots},
        "refined": {"start": 4, "steps": 2, "score_before": -0.5, "score": -0.4,
                    "agree_before": [], "agree": ["speed"], "facts": facts},
        "searches": [{"objective": ALL, "start": 0, "agree": ["speed"], "facts": facts}],
        "front": [{"facts": facts, "assumptions": robots["built-in robot"]}],
        "facts": {name: facts for name in robots},
        "single_changes": [{"assumption": "k", "value": 0.02,
                            "facts": facts | {"sweep_peak_N": None}}],
        "head_drag": [{"area_m2": 1.9e-3, "speed_53_mm_m_per_s": 0.21,
                       "speed_70_mm_m_per_s": 0.217}],
        "figures": ["fig4.png"],
    }  # fmt: skip


def test_the_page_and_the_table_show_every_statement():
    judgements = [*judged(evidence(agreeing_facts(), agreeing_facts())), *judged_front(None)]
    record = record_of(judgements)
    page = statements_page(record)
    for x in judgements:
        assert x.text.replace("'", "&#39;").replace("<", "&lt;") in page, x.name
    assert "<td>19.0</td>" in page and 'src="fig4.png"' in page
    summary = statements_summary(record)
    assert "sweep peak frequency" in summary and "time per step" not in summary


def test_each_statement_is_in_one_table_whose_rows_have_the_columns_of_the_head():
    judgements = [*judged(evidence(agreeing_facts(), agreeing_facts())), *judged_front(None)]
    assert summary_sentence(judgements) == summary_sentence(judgements[: -len(OF_FRONT)])
    tables = statement_tables(record_of(judgements))
    assert all(len(row) == len(x.head) for x in tables.values() for row in x.rows)
    of_statements = [
        tables[name].rows for name in ("simulated", "printed", "undecidable", "others")
    ]
    assert sum(map(len, of_statements)) == len(judgements)
    assert tables["changes"].rows[1] == ["k", "0.02", "–", "4.8", "36.0", "23.2"]
    assert tables["gradients"].rows[0][:6] == ["4", "2", "-0.500", "-0.400", "0", "1"]
    (contradiction,) = [x for x in tables["printed"].rows if "slightly shorter" in x[1]]
    assert contradiction[-1] == INCONSISTENT
    (fig_9, *_) = [x for x in tables["simulated"].rows if x[0] == FIG_9]
    assert fig_9[-2] == OMITTED and "slider optimize multimodal" in fig_9[-1]


@pytest.mark.slow
def test_the_stored_assumptions_give_the_stored_agreements(tmp_path):
    """The best set of all searches, simulated again by the present program."""
    best = joint_fit()["refined"]
    simulate = Simulator(FINE, tmp_path / "log.jsonl")
    points = np.array([to_unit(fitted_assumptions(joint_fit())), to_unit(Assumptions())])
    fitted, built_in = simulate(points)
    agree = [name for name in COUNTED if SIMULATED[name].agrees(fitted[SIMULATED[name].fact])]
    assert agree == best["agree"]
    for name, value in best["facts"].items():
        assert fitted[name] == pytest.approx(value, rel=1e-6)
    assert sum(SIMULATED[x].agrees(built_in[SIMULATED[x].fact]) for x in COUNTED) < len(agree)
    assert len((tmp_path / "log.jsonl").read_text().splitlines()) == 2
    assert json.loads((tmp_path / "log.jsonl").read_text().splitlines()[0])["facts"] == fitted
