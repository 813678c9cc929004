"""The statements on Fig. 9: synthetic fronts, and files that are refused."""

import json

import pytest

from slider_jax.cli.main import main
from slider_jax.errors import InputError
from slider_jax.optimise.two_tasks import NAMES
from slider_jax.statements.multimodal import OF_FRONT, front_facts, judged_front, load_front
from slider_jax.statements.statements import MISSED, OMITTED, REPRODUCED
from tests.support.fronts import front_of


def verdicts(front):
    return {x.name: x.verdict for x in judged_front(front)}


def test_a_front_that_changes_in_one_step_agrees_with_fig_9():
    found = front_facts(front_of(7, sudden=True))
    assert found["largest_step_share"] == pytest.approx(1.0)
    assert found["tail_change"] == found["drive_change"] == pytest.approx(0.5)
    assert verdicts(front_of(7, sudden=True)) == dict.fromkeys(OF_FRONT, REPRODUCED)


def test_a_front_that_changes_evenly_does_not_shift_rapidly():
    assert front_facts(front_of(7))["largest_step_share"] == pytest.approx(1.0 / 6.0)
    found = verdicts(front_of(7))
    assert found.pop("rapid_shift") == MISSED and set(found.values()) == {REPRODUCED}


def test_a_front_without_a_change_and_a_missing_front():
    same = front_of(5)
    for row in same["front"]:
        row.update(dict.fromkeys(NAMES, 0.5))
    assert set(verdicts(same).values()) == {MISSED}
    assert set(verdicts(None).values()) == {OMITTED}


def test_phases_half_a_period_apart_from_the_other_side_are_the_same():
    front = front_of(5)
    for row in front["front"]:
        row.update(dict.fromkeys(NAMES, 0.5))
    front["front"][0]["phase"], front["front"][3]["tail_length"] = -0.5, 0.4
    assert front_facts(front)["largest_step_share"] == pytest.approx(0.5)  # there and back


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({}, ""),
        ({"inputs": [{"path": "other.toml"}]}, "belongs to other.toml"),
        ({"front": front_of(3)["front"]}, "allowed at most 0.25"),
        ({"alone": {"E_swim": 0.2, "E_climb": 0.79}}, "E_climb alone reached 0.79, less than"),
    ],
)
def test_only_a_fine_front_of_the_built_in_robot_is_read(tmp_path, changed, message):
    with pytest.raises(InputError, match=r"multimodal\.json is missing; write it with"):
        load_front(tmp_path)
    (tmp_path / "multimodal.json").write_text(json.dumps(front_of(5) | changed))
    if message:
        with pytest.raises(InputError, match=message):
            load_front(tmp_path)
    else:
        found = load_front(tmp_path)
        assert verdicts(found) and len(found["file"]["sha256"]) == 64


def test_a_front_needs_all(tmp_path, capsys):
    assert main(["published", "--out", str(tmp_path), "--front", str(tmp_path)]) == 2
    assert "add --all" in capsys.readouterr().err
