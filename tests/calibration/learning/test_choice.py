"""Whether a function is learned instead of the doubtful effects or beside them."""

from types import SimpleNamespace

import pytest

from calibration.learning import learn
from calibration.learning.learn import learn_terms

STATUSES = [
    SimpleNamespace(name="leakage", status="provisional", above_floor=["p_rear"]),
    SimpleNamespace(name="camera_delay", status="identified", above_floor=[]),
]


def choice(monkeypatch, squares, at_floor=(), statuses=STATUSES, halves=True):
    """Returns the number of the chosen attempt, and the effects of each attempt.

    `squares` are the sums of squares of the attempts' models; None: nothing was learned.
    """
    attempts = []

    def learned(outcome, effects, progress):
        k = len(attempts)
        attempts.append(list(effects))
        model = squares[k] and SimpleNamespace(fit=SimpleNamespace(square=squares[k]))
        estimation = [0] if halves else []
        return SimpleNamespace(
            model=model, estimation=estimation, reaches_floor=k in at_floor, number=k
        )

    monkeypatch.setattr(learn, "_learned", learned)
    effects = [x.name for x in statuses]
    outcome = SimpleNamespace(verdict="partly_explained", statuses=statuses, effects=effects)
    return learn_terms(outcome).number, attempts


def test_a_function_at_the_noise_floor_replaces_the_doubtful_effects(monkeypatch):
    assert choice(monkeypatch, [5.0], at_floor=[0]) == (0, [["camera_delay"]])


@pytest.mark.parametrize(
    ("squares", "chosen"),
    [([5.0, 4.0], 1), ([4.0, 5.0], 0), ([None, 5.0], 1), ([5.0, None], 0), ([None, None], 1)],
)
def test_the_better_of_two_functions_above_the_floor_is_kept(monkeypatch, squares, chosen):
    both = [["camera_delay"], ["leakage", "camera_delay"]]
    assert choice(monkeypatch, squares) == (chosen, both)


def test_without_doubtful_effects_or_trials_there_is_one_attempt(monkeypatch):
    assert choice(monkeypatch, [None], statuses=STATUSES[1:]) == (0, [["camera_delay"]])
    assert choice(monkeypatch, [None], halves=False)[0] == 0
