"""Whether a function is learned instead of the corrections or beside them."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from calibration.discrepancy.settings import SelectionSettings
from calibration.learning import learn
from calibration.learning.learn import Learning, learn_terms
from calibration.learning.pursuit import PlaceGain

EFFECTS, CORRECTIONS = ["leakage", "camera_delay"], ["leakage"]


def choice(monkeypatch, growths, at_floor=(), corrections=CORRECTIONS):
    """Returns the number of the chosen attempt, and the effects of each attempt.

    `growths` are the growths of the error by the attempts' models; None: nothing was learned.
    """
    attempts = []

    def learned(found, known, progress):
        k = len(attempts)
        attempts.append(known)
        found.number, growth = k, growths[k]
        if growth is not None:
            growth = SimpleNamespace(mean=growth)
            found.model = SimpleNamespace(
                growth=growth, above_floor=[] if k in at_floor else ["tip"]
            )
        return found

    monkeypatch.setattr(learn, "_learned", learned)
    monkeypatch.setattr(learn, "largest_states", lambda problem, fit: {})
    monkeypatch.setattr(learn.Dictionary, "of", lambda outcome, effects, *_: list(effects))
    monkeypatch.setattr(learn, "TankProblem", SimpleNamespace)
    records = [SimpleNamespace(trial=SimpleNamespace(frequency=1.0 + i)) for i in range(8)]
    problem = SimpleNamespace(records=records, part=lambda chosen: None)
    outcome = SimpleNamespace(
        verdict="partly_explained",
        effects=EFFECTS,
        corrections=corrections,
        problem=problem,
        used_trials=list(range(8)),
        chosen=None,
    )
    found = learn_terms(outcome)
    assert found.model is None or found.reaches_floor or found.model.growth.mean < 0.0
    return found.number, attempts


def test_a_function_at_the_noise_floor_replaces_all_effects(monkeypatch):
    assert choice(monkeypatch, [-2.0], at_floor=[0]) == (0, [[]])


def test_a_function_at_the_noise_floor_replaces_the_corrections(monkeypatch):
    found = choice(monkeypatch, [-3.0, -2.0], at_floor=[1])
    assert found == (1, [[], ["camera_delay"]])


@pytest.mark.parametrize(
    ("growths", "at_floor", "chosen"),
    [
        ([-1.0, -1.5, -2.0], [], 2),
        ([-1.0, -2.0, -1.5], [], 1),
        ([-2.0, -1.0, -0.5], [2], 2),
        ([None, None, 0.01], [], 2),
        ([-0.1, None, None], [], 0),
        ([0.04, None, None], [], 2),  # the loop's model without a function is better
        ([None, None, None], [], 2),
    ],
)
def test_a_function_above_the_floor_has_to_improve_the_model(
    monkeypatch, growths, at_floor, chosen
):
    attempts = [[], ["camera_delay"], EFFECTS]
    assert choice(monkeypatch, growths, at_floor) == (chosen, attempts)


def test_no_attempt_is_repeated(monkeypatch):
    assert choice(monkeypatch, [None, None], corrections=[]) == (1, [[], EFFECTS])
    assert choice(monkeypatch, [None, None], corrections=EFFECTS) == (1, [[], EFFECTS])


@pytest.mark.parametrize(
    ("confirmed", "order", "refused", "equal"),
    [
        ("Flow", ["Flow", "Command", "Instrument (tip)"], [], ["Command"]),
        ("Command", ["Command", "Flow", "Instrument (tip)"], ["Flow"], ["Flow"]),
        ("", ["Flow", "Command", "Instrument (tip)"], ["Flow", "Command"], None),
    ],
)
def test_the_next_place_is_tried_if_the_other_trials_refuse_the_best(
    monkeypatch, confirmed, order, refused, equal
):
    places = [
        PlaceGain("Flow", ["flow_of_filling"], 100.0, 80.0, None),
        PlaceGain("Command", ["a_command", "b_command"], 99.0, 79.0, None),
        PlaceGain("Instrument (tip)", [], 0.0, 0.0, None),
    ]

    def estimate(found, known, place, many, progress):
        assert many == 3
        found.reason = f"{place.place} is refused"
        if place.place == confirmed:
            found.model, found.reason = SimpleNamespace(above_floor=[]), ""

    monkeypatch.setattr(learn, "_estimate", estimate)
    settings = SimpleNamespace(equal_gain_share=0.95)
    outcome = SimpleNamespace(search=SimpleNamespace(settings=settings))
    known = SimpleNamespace(effects=[], places={}, search=lambda progress: list(places))
    found = learn._learned(Learning(outcome), known, print)
    assert [x.place for x in found.places] == order and list(found.refused) == refused
    assert found.reason == ("" if confirmed else "Flow is refused")
    assert found.reaches_floor == bool(confirmed)
    if equal is not None:
        assert found.equal_places == equal
        found.refused = dict.fromkeys(refused, learn.NOT_CONFIRMED)
        assert found.equal_places == [x for x in equal if x not in refused]


def test_without_a_significant_term_nothing_is_estimated(monkeypatch):
    monkeypatch.setattr(learn, "_estimate", None)
    places = [PlaceGain("Flow", [], 0.0, 0.0, None)]
    known = SimpleNamespace(effects=[], places={}, search=lambda progress: places)
    found = learn._learned(Learning(None), known, print)
    assert found.model is None and "no term" in found.reason and not found.refused


def several(
    monkeypatch, effects, terms=("a",), loss=0.0, *, verdict="identified", above=(), trials=8
):
    """Returns the result for an outcome that names the `effects`, and the effects of each attempt.

    Each effect has one fitted parameter, and each of the function's `terms` has three. `loss` is
    the loss by the function, in units of the residual's mean square, which is 2.
    """
    attempts, squares = [], (100.0, 100.0 + 2.0 * loss)

    def learned(found, known, progress):
        attempts.append(known)
        if terms:
            found.model = SimpleNamespace(
                terms=terms,
                above_floor=list(above),
                problem=problem,
                fit=SimpleNamespace(predicted=1, free=range(3 * len(terms))),
                dictionary=SimpleNamespace(
                    entries=[SimpleNamespace(effect=name) for name in terms for _ in range(3)]
                ),
                growth=SimpleNamespace(mean=-1.0),
            )
        return found

    monkeypatch.setattr(learn, "_learned", learned)
    monkeypatch.setattr(learn, "largest_states", lambda problem, fit: {})
    monkeypatch.setattr(learn.Dictionary, "of", lambda outcome, effects, *_: list(effects))
    monkeypatch.setattr(learn, "TankProblem", SimpleNamespace)
    records = [SimpleNamespace(trial=SimpleNamespace(frequency=1.0 + i)) for i in range(trials)]
    problem = SimpleNamespace(
        records=records,
        part=lambda chosen: None,
        whiteners=lambda predicted: None,
        residuals=lambda predicted, white: {(0, "tip"): np.sqrt([squares[predicted]])},
    )
    outcome = Outcome(
        verdict=verdict,
        effects=effects,
        corrections=[],
        problem=problem,
        used_trials=list(range(trials)),
        chosen=SimpleNamespace(predicted=0, inflation=2.0, free=range(len(effects))),
        search=SimpleNamespace(settings=SelectionSettings(min_gain=20.0)),
        entries=[SimpleNamespace(effect=name) for name in effects],
    )
    return learn_terms(outcome), attempts


@dataclass(frozen=True)
class Outcome:
    """The fields of an outcome that the choice reads or replaces."""

    verdict: str
    effects: list[str]
    corrections: list[str]
    problem: SimpleNamespace
    used_trials: list[int]
    chosen: SimpleNamespace
    search: SimpleNamespace
    entries: list[SimpleNamespace]
    replaceable: bool = False


PRESSURES = ["leakage", "choked_flow", "actuator_saturation"]
COST = SelectionSettings(min_gain=20.0).least_gain(3)
"""Gain that a term must have, 26.4."""


@pytest.mark.parametrize("verdict", ["identified", "class"])
@pytest.mark.parametrize(
    ("terms", "loss"), [(["a", "b"], 59.0 - 2.0 * COST), (["a"], 59.0 - COST), (["a"], -50.0)]
)
def test_fewer_terms_that_explain_the_data_as_well_replace_several_effects(
    monkeypatch, terms, loss, verdict
):
    found, attempts = several(monkeypatch, PRESSURES, terms, loss, verdict=verdict)
    assert found.outcome.replaceable and found.outcome.verdict == "learned"
    assert found.model.terms == terms and attempts == [[]]


@pytest.mark.parametrize(
    ("terms", "loss", "above"),
    [
        (["a", "b", "c"], -200.0, ()),  # as many terms as effects
        (["a", "b"], 61.0 - 2.0 * COST, ()),
        (["a"], 61.0 - COST, ()),
        (["a"], 0.0, ["tip"]),
        ([], 0.0, ()),
    ],
)
def test_several_effects_remain_causes(monkeypatch, terms, loss, above):
    assert several(monkeypatch, PRESSURES, terms, loss, above=above) == (None, [[]])


@pytest.mark.parametrize(
    ("effects", "tested"),
    [
        (["leakage"], False),
        (["leakage", "tail_drag"], False),
        (["leakage", "choked_flow"], True),
        (["valve_delay", "actuator_saturation"], True),  # both change the pneumatics
        (["camera_scale", "force_gain"], False),  # two different sensors
        (["leakage", "tail_drag", "camera_delay"], True),
    ],
)
def test_a_function_is_tested_for_three_effects_or_two_of_one_part(monkeypatch, effects, tested):
    found, attempts = several(monkeypatch, effects)
    assert attempts == ([[]] if tested else [])
    assert (found is not None) == tested


def test_too_few_trials_leave_the_effects(monkeypatch):
    assert several(monkeypatch, PRESSURES, trials=5) == (None, [])


def test_three_effects_above_the_floor_get_all_attempts(monkeypatch):
    found, attempts = several(monkeypatch, PRESSURES, verdict="partly_explained", above=["tip"])
    assert attempts == [[], PRESSURES] and not found.outcome.replaceable
