"""Whether a function is learned instead of the corrections or beside them."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from calibration.discrepancy.settings import SelectionSettings
from calibration.learning import learn
from calibration.learning.learn import Learning, learn_terms
from calibration.learning.pursuit import PlaceGain
from calibration.model.extended import Parameter
from slider_jax.effects.base import Prior

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
        for reason in (learn.NOT_CONFIRMED, learn.VETOED, learn.TOO_LITTLE):
            found.refused = dict.fromkeys(refused, reason)
            assert found.equal_places == [x for x in equal if x not in refused]


def test_without_a_significant_term_nothing_is_estimated(monkeypatch):
    monkeypatch.setattr(learn, "_estimate", None)
    places = [PlaceGain("Flow", [], 0.0, 0.0, None)]
    known = SimpleNamespace(effects=[], places={}, search=lambda progress: places)
    found = learn._learned(Learning(None), known, print)
    assert found.model is None and "no term" in found.reason and not found.refused


def several(
    monkeypatch,
    effects,
    terms=("a",),
    loss=0.0,
    *,
    verdict="identified",
    above=(),
    trials=8,
    growth=-1.0,
    p=1e-5,
    value=0.5,
    low=-1.0,
    fine=(),
):
    """Returns the result for an outcome that names the `effects`, and the effects of each attempt.

    `p` is the p-value of a candidate beside the effects. `value` is the effects' parameter, whose
    range is from `low` to 1. Each effect has one fitted parameter, and each of the function's
    `terms` has three. `loss` is the loss by the function, in units of the residual's mean square,
    which is 2.
    """
    given = list(effects)
    attempts, squares = [], (1000.0, 1000.0 + 2.0 * loss)

    def learned(found, known, progress, accepts=None):
        assert accepts is (None if verdict == "partly_explained" else learn._competes)
        attempts.append(known)
        if terms:
            found.model = SimpleNamespace(
                terms=terms,
                fine_parts=list(fine),
                above_floor=list(above),
                problem=problem,
                fit=SimpleNamespace(predicted=1, free=range(3 * len([*terms, *fine]))),
                dictionary=SimpleNamespace(
                    entries=[
                        SimpleNamespace(effect=name) for name in [*terms, *fine] for _ in range(3)
                    ]
                ),
                growth=SimpleNamespace(mean=growth),
            )
        return found

    monkeypatch.setattr(learn, "_learned", learned)
    monkeypatch.setattr(learn, "largest_states", lambda problem, fit: {})

    def dictionary(outcome, effects, contained, *_):
        # The test of doubtful effects uses the programs of every experiment.
        assert list(contained) == (given if verdict == "partly_explained" else [])
        return list(effects)

    monkeypatch.setattr(learn.Dictionary, "of", dictionary)
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
        chosen=SimpleNamespace(
            predicted=0, inflation=2.0, free=range(len(effects)), theta=np.full(len(effects), value)
        ),
        search=SimpleNamespace(
            settings=SelectionSettings(min_gain=20.0),
            rounds=[
                SimpleNamespace(scores=[SimpleNamespace(p=0.0, name="x")]),
                # The last round may have added an effect itself.
                SimpleNamespace(
                    scores=[
                        SimpleNamespace(p=0.0, name=effects[-1]),
                        SimpleNamespace(p=p, name="x"),
                    ]
                ),
            ],
        ),
        entries=[Parameter(name, "size", Prior(0.0, low, 1.0, "-", "a test")) for name in effects],
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
        (["a", "b", "c"], 41.0 - 3.0 * COST, ()),  # as many terms as effects
        (["a", "b"], 61.0 - 2.0 * COST, ()),
        (["a"], 61.0 - COST, ()),
        (["a"], 0.0, ["tip"]),
        ([], 0.0, ()),
    ],
)
def test_several_effects_remain_causes(monkeypatch, terms, loss, above):
    assert several(monkeypatch, PRESSURES, terms, loss, above=above) == (None, [[]])


@pytest.mark.parametrize(
    ("effects", "terms"),
    [(["leakage"], ["a"]), (["leakage"], ["a", "b"]), (["leakage", "tail_drag"], ["a", "b", "c"])],
)
def test_more_terms_have_to_explain_the_data_better(monkeypatch, effects, terms):
    """By 20 more than the required gains of the terms exceed those of the effects."""
    limit = 20.0 * len(effects) - COST * len(terms) - 20.0
    found, attempts = several(monkeypatch, effects, terms, limit - 0.1)
    assert found.outcome.replaceable and found.outcome.verdict == "learned" and attempts == [[]]
    assert several(monkeypatch, effects, terms, limit + 0.1)[0] is None
    # The error in the held-out trials must be smaller.
    assert several(monkeypatch, effects, terms, limit - 0.1, growth=0.01)[0] is None


def test_terms_compete_if_they_lose_little_in_the_readings_of_the_selection():
    """Terms may lose 40 against two effects, because each effect must gain 20."""

    def competes(loss):
        squares = (100.0, 100.0 + 2.0 * loss)
        selection = SimpleNamespace(
            whiteners=lambda predicted: None,
            residuals=lambda predicted, white: {(0, "tip"): np.sqrt([squares[predicted]])},
        )
        problem = SimpleNamespace(
            part=lambda used: SimpleNamespace(
                during=lambda mask: selection if mask is learn.in_selection else None
            )
        )
        chosen = SimpleNamespace(predicted=0, inflation=2.0, free=range(2))
        outcome = SimpleNamespace(
            used_trials=[],
            chosen=chosen,
            effects=["leakage", "tail_drag"],
            entries=[SimpleNamespace(effect=name) for name in ("leakage", "tail_drag")],
            search=SimpleNamespace(settings=SelectionSettings(min_gain=20.0)),
        )
        place = PlaceGain("Flow", ["a"], 0.0, 0.0, SimpleNamespace(predicted=1))
        return learn._competes(SimpleNamespace(outcome=outcome, problem=problem), place)

    assert competes(39.9) and not competes(40.1)


def test_a_place_whose_terms_do_not_compete_is_not_estimated(monkeypatch):
    places = [
        PlaceGain("Flow", ["flow_of_filling"], 100.0, 80.0, None),
        PlaceGain("Command", ["a_command", "b_command"], 99.0, 79.0, None),
    ]
    estimated = []

    def estimate(found, known, place, many, progress):
        estimated.append((place.place, many))
        found.model = SimpleNamespace(above_floor=[])

    monkeypatch.setattr(learn, "_estimate", estimate)
    known = SimpleNamespace(effects=[], places={}, search=lambda progress: list(places))
    found = learn._learned(Learning(None), known, print, lambda _, x: x.place == "Command")
    # The p-values are corrected for the selected terms of all places.
    assert estimated == [("Command", 3)] and found.refused == {"Flow": learn.WORSE}
    found = learn._learned(Learning(None), known, print, lambda *_: False)
    assert found.model is None and found.reason == learn.WORSE


@pytest.mark.parametrize(
    ("effects", "p", "value", "tested"),
    [
        (["leakage"], 1.1e-4, 0.5, False),
        (["leakage"], 0.9e-4, 0.5, True),  # a candidate is significant
        (["leakage"], 1.0, 1.0 - 1e-3, True),  # the parameter cannot grow
        (["leakage"], 1.0, -1.0 + 1e-3, True),
        (["leakage", "tail_drag"], 1.0, 0.5, False),
        (["leakage", "tail_drag"], 0.9e-4, 0.5, True),
        (["leakage", "choked_flow"], 1.0, 0.5, True),
        (["valve_delay", "actuator_saturation"], 1.0, 0.5, True),  # both change the pneumatics
        (["camera_scale", "force_gain"], 1.0, 0.5, False),  # two different sensors
        (["leakage", "tail_drag", "camera_delay"], 1.0, 0.5, True),
    ],
)
def test_a_function_is_tested_only_against_doubtful_effects(monkeypatch, effects, p, value, tested):
    found, attempts = several(monkeypatch, effects, loss=-200.0, p=p, value=value)
    assert attempts == ([[]] if tested else [])
    assert (found is not None) == tested


def test_a_detail_of_a_function_counts_like_a_term(monkeypatch):
    limit = 20.0 - 2.0 * COST - 20.0
    for loss, replaced in ((limit - 0.1, True), (limit + 0.1, False)):
        found, _ = several(monkeypatch, ["leakage"], loss=loss, fine=["a_fine"])
        assert (found is not None) == replaced


def test_an_effect_with_the_wrong_sign_is_doubtful(monkeypatch):
    """A fit may go beyond the null by 5 % of the range if the range ends at the null."""
    assert several(monkeypatch, ["leakage"], loss=-200.0, p=1.0, low=0.0, value=0.02) == (None, [])
    found, _ = several(monkeypatch, ["leakage"], loss=-200.0, p=1.0, low=0.0, value=-0.049)
    assert found.outcome.replaceable


def test_too_few_trials_leave_the_effects(monkeypatch):
    assert several(monkeypatch, PRESSURES, trials=5) == (None, [])


def test_three_effects_above_the_floor_get_all_attempts(monkeypatch):
    found, attempts = several(monkeypatch, PRESSURES, verdict="partly_explained", above=["tip"])
    assert attempts == [[], PRESSURES] and not found.outcome.replaceable
