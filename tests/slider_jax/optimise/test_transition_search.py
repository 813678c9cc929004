"""`slider optimize transition` on a coarse robot near the wall: schedules, parts, resuming."""

import json

import numpy as np
import pytest

from slider_jax.cli.main import main
from slider_jax.errors import InputError
from slider_jax.experiment.load import load
from slider_jax.optimise.design_space import to_toml
from slider_jax.optimise.loop import CHECKPOINT
from slider_jax.optimise.population import Evaluation
from slider_jax.optimise.transition_search import (
    CHANGE,
    CROSSING_BOUNDS,
    PARTS,
    START,
    CrossingTask,
    crossing_speed,
    schedule_from,
    with_crossing,
)
from slider_jax.transition.example import example_crosser
from slider_jax.transition.run import simulate_transition


def near_the_wall(**changes):
    short = {"depth": 0.3, "height": 0.0, "duration": 5.0} | changes
    return example_crosser().with_values(
        {"numerics.nodes": 15, "numerics.step": 5e-3}
        | {f"transition.{name}": x for name, x in short.items()}
    )


def test_the_schedule_switches_from_the_swimming_gait_to_the_climbing_gait():
    found = schedule_from(START)
    np.testing.assert_allclose(found.time, [0.0, START["switch"], START["switch"] + CHANGE])
    for name in ("frequency", "front", "rear", "phase"):
        swim, climb = START[f"swim_{name}"], START[f"climb_{name}"]
        np.testing.assert_allclose(getattr(found, name), [swim, swim, climb])


def test_a_part_alone_has_one_gait_and_units_are_inverted():
    task = CrossingTask.of(near_the_wall(), {"tail_length": (0.03, 0.05)})
    for part, names in PARTS.items():
        unit = np.linspace(0.1, 0.9, len(names))
        values = task.values(part, unit)
        np.testing.assert_allclose(task.unit(part, values), unit, rtol=1e-12)
        assert 0.03 <= values["tail_length"] <= 0.05
        if part != "transition":
            assert values["swim_frequency"] == values["climb_frequency"]
    assert set(START) == set(CROSSING_BOUNDS)
    assert [round(task.way(part), 9) for part in PARTS] == [0.2, 0.1, 0.3]


def test_the_score_is_the_mean_speed_to_the_goal():
    """The time of the written experiment, which `slider transition` simulates with its events."""
    task = CrossingTask.of(near_the_wall(height=-0.15, wall_from=-0.16), {})
    unit = task.unit("transition", START)
    score = float(Evaluation(crossing_speed(task, "transition"), chunk=1)(unit[None])[0])
    run = simulate_transition(with_crossing(task, unit))
    print(score, run.reached)
    np.testing.assert_allclose(score, 0.15 / run.reached, rtol=1e-9)


def test_what_cannot_be_optimised_is_refused():
    with pytest.raises(InputError, match="tail-length"):
        CrossingTask.of(near_the_wall(), {"tail_length": (0.05, 0.03)})
    slow = near_the_wall().with_values({"numerics.step": 8e-3})
    with pytest.raises(InputError, match="shortest period"):
        CrossingTask.of(slow, {})


@pytest.mark.slow
def test_the_command_searches_writes_and_resumes(tmp_path, capsys):
    """One generation; a resumed search that has nothing left to do writes the same result."""
    path, out = tmp_path / "near.toml", tmp_path / "out"
    path.write_text(to_toml(near_the_wall()))
    words = ["optimize", "transition", str(path), "--population", "4", "--generations", "1"]
    assert main([*words, "--out", str(out)]) == 0
    text = capsys.readouterr().out
    assert "swim alone" in text and "steps/s" in text or "refined" in text
    first = json.loads((out / "optimum.json").read_text())
    for part, names in PARTS.items():
        found = first["parts"][part]
        assert (out / part / CHECKPOINT).exists() and found["design"].keys() == set(names)
        assert found["history"][0]["evaluations"] == 4
    best = load(out / "best.toml")
    assert len(best.transition.schedule) == 3
    assert best.robot.tail_length == pytest.approx(first["parts"]["transition"]["design"]
                                                   ["tail_length"])  # fmt: skip
    assert first["transition"]["nodes"] == 15 and first["on_refined_mesh"]["nodes"] == 29
    assert (out / "optimum.png").stat().st_size > 10_000
    assert main([*words, "--out", str(out)]) == 2
    assert "--resume" in capsys.readouterr().err
    assert main([*words, "--resume", "--out", str(out)]) == 0
    again = json.loads((out / "optimum.json").read_text())
    assert again["parts"] == first["parts"] and again["transition"] == first["transition"]
