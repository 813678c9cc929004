"""The choice of held-out trials."""

import numpy as np

from calibration.discrepancy.close_loop import choose_held_out
from calibration.measurements.records import Record
from slider_jax.channels import SLIDER_CHANNELS
from slider_jax.experiment.schema import Trial


def records(towed, count=8):
    found = []
    for i, f in enumerate(np.geomspace(0.6, 6.0, count)):
        content = {"file": f"{i}.csv", "frequency": round(float(f), 2), "amplitude": 2e5}
        speed = 0.2 if i in towed else 0.0
        trial = Trial.model_validate(content | {"duration": 2.0, "tow_speed": speed})
        found.append(Record(trial, np.zeros(1), np.zeros((5, 1)), SLIDER_CHANNELS))
    return found


def test_a_quarter_of_the_trials_inside_the_frequency_range_is_held_out():
    assert choose_held_out(records(towed=())) == [2, 6]
    assert choose_held_out(records(towed=range(8))) == [2, 6]
    assert choose_held_out(records(towed=(), count=5)) == []
    third = records(towed=())[2].trial.file
    assert choose_held_out(records(towed=()), [third]) == [1, 6]


def test_two_towed_trials_are_not_held_out():
    for towed in ((1, 6), (2, 6), (2, 7), (5, 6), (0, 2, 6)):
        held = choose_held_out(records(towed))
        assert held and not set(held) & {0, 7}
        assert len(set(towed) - set(held)) >= 2, (towed, held)
    assert len(choose_held_out(records(towed=(5, 6)))) == 1


def test_two_trials_in_still_water_are_not_held_out():
    held = choose_held_out(records(towed=(0, 1, 3, 4, 5, 7)))
    assert not set(held) & {2, 6}
