"""Tests of the way from the water to the wall: energy, outcomes, refusals, gradient, command."""

import json

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.cli.main import main
from slider_jax.dynamics.step import at_rest
from slider_jax.errors import InputError
from slider_jax.experiment.load import Experiment, load
from slider_jax.optimise.design_space import to_toml
from slider_jax.supports.gripping import HOLDING
from slider_jax.transition.crossing import continue_crossing, schedule_of, to_crosser, with_schedule
from slider_jax.transition.example import example_crosser
from slider_jax.transition.run import (
    crossing_settings,
    energies,
    outcome,
    simulate_transition,
    transition_record,
)
from tests.support.data import ROOT

DOCS = ROOT / "docs"
CLIMB = {"frequency": 2.0, "front": 172e3, "rear": 172e3}


def crosser(*, numerics=None, robot=None, **transition) -> Experiment:
    """The built-in robot on a coarse mesh, 0.3 m below the surface, with changes."""
    given = example_crosser()
    own = {"depth": 0.3, "height": 0.05, "duration": 4.0} | transition
    changes = {f"transition.{k}": v for k, v in own.items()}
    robot = {"tail_length": 0.07, "EI_tail": 0.0058} | (robot or {})
    changes |= {f"robot.{k}": v for k, v in robot.items()}
    return given.with_values({"numerics": {"nodes": 15, "step": 4e-3} | (numerics or {})} | changes)


def schedule(switch, swim=None, climb=None):
    swim = {"frequency": 5.0, "front": 400e3, "rear": 400e3, "phase": 0.14} | (swim or {})
    return [{"time": 0.0, **swim}, {"time": switch, **swim},
            {"time": switch + 0.2, **CLIMB, **(climb or {})}]  # fmt: skip


@pytest.fixture(scope="module")
def climbing():
    """A run that swims, grips and climbs for some strides, without a goal."""
    return simulate_transition(crosser(schedule=schedule(1.2), height=5.0, duration=5.0))


def test_the_robot_swims_grips_and_rises_out_of_the_water(climbing):
    x = climbing.series
    gripped = climbing.gripped
    at = round(gripped / climbing.settings.step)
    print(outcome(climbing))
    assert climbing.ok and 0.5 < gripped < 1.5
    assert np.all(x.wet[:at] == 1.0) and x.wet[-1] < 0.9
    assert abs(x.head[at - 1, 0] + 0.1) < 0.02  # the wall begins 0.1 m below the surface
    assert x.head[-1, 0] > x.head[at, 0] + 0.05
    held = (x.status == HOLDING).sum(axis=1)
    assert held[at:].mean() > 0.9 and held.max() == 1
    assert outcome(climbing)[0] == "leaving the water"


def test_the_energy_balance_closes(climbing):
    found = energies(climbing)
    print(found)
    assert found["work_J"] > 0.2 and found["to_water_J"] > 0.1
    assert abs(found["unaccounted_J"]) < 0.02 * found["work_J"]
    assert found["to_spines_J"] > 0.0 and found["to_body_J"] > 0.0


def test_outcomes_name_the_phase_and_the_reason():
    weak = schedule(10.0, {"front": 20e3, "rear": 20e3})
    cases = {
        "goal": (crosser(schedule=schedule(1.2), height=-0.06), "after"),
        "swimming": (crosser(schedule=weak), "too slow"),
        "gripping": (
            crosser(schedule=schedule(1.2), spines={"pull_off": 0.1}), "pull-off force of 0.1 N"
        ),
        "leaving the water": (crosser(schedule=schedule(10.0)), "does not climb"),
    }  # fmt: skip
    for phase, (experiment, text) in cases.items():
        run = simulate_transition(experiment)
        found = outcome(run)
        print(phase, found)
        assert found[0] == phase and text in found[1]
        record = transition_record(run)
        assert (record["time_to_goal_s"] is None) == (phase != "goal")


def test_a_failed_step_is_an_outcome_and_not_an_error():
    huge = schedule(1.2, {"front": 1e6, "rear": 1e6})
    run = simulate_transition(
        crosser(schedule=huge, robot={"EI_body": 3e-3, "EI_tail": 1e-5},
                numerics={"step": 9e-3, "scheme": "backward_euler"})
    )  # fmt: skip
    phase, text = outcome(run)
    print(phase, text)
    assert not run.ok and phase == "swimming" and "did not converge at" in text


def test_the_gradient_of_the_height_through_water_and_contact_is_that_of_differences():
    """Place of the head after grips above the surface, by the amplitudes of both chambers.

    No grip begins or ends in another step for these changes.
    """
    experiment = crosser(schedule=schedule(0.1), depth=0.03, wall_from=0.02, start_speed=0.5)
    base, settings = to_crosser(experiment), crossing_settings(experiment)._replace(block=100)
    given = schedule_of(experiment.transition)

    @eqx.filter_jit
    def end(x):
        changed = given._replace(front=x[0] * given.front, rear=x[1] * given.rear)
        model = with_schedule(base, changed)
        carry, series = continue_crossing(
            model, at_rest(model, settings.numerics), jnp.zeros(()), settings
        )
        return carry.memory.head[0] + carry.memory.head[1], (series.status, series.wet)

    at = jnp.ones(2)
    (_, (status, wet)), step = end(at), 1e-6
    assert (np.asarray(status) == HOLDING).any() and float(wet[-1]) < 1.0
    found = np.asarray(jax.jacfwd(lambda x: end(x)[0])(at))
    differences = []
    for i in range(2):
        (upper, (a, _)), (lower, (b, _)) = end(at.at[i].add(step)), end(at.at[i].add(-step))
        np.testing.assert_array_equal(a, b)
        differences.append(float(upper - lower) / (2.0 * step))
    print(found, differences)
    np.testing.assert_allclose(found, differences, rtol=1e-4)


def test_what_cannot_be_simulated_is_refused():
    example = example_crosser()
    cases = {
        "transition: missing": {"transition": None},
        "robot.density: missing": {"robot.density": None},
        "tip_mass": {"effects": [{"name": "tip_mass", "mass": 0.01}]},
        "water": {"water": {"velocity": (0.1, 0.0)}},
    }
    for text, change in cases.items():
        with pytest.raises(InputError, match=text):
            to_crosser(example.with_values(change))
    with pytest.raises(InputError, match="increase"):
        example.with_values({"transition.schedule": schedule(1.0)[::-1]})
    with pytest.raises(InputError, match="shortest period"):
        example.with_values({"numerics.step": 0.02})


def test_the_command_writes_record_series_picture_and_film(tmp_path, capsys):
    path, out = tmp_path / "short.toml", tmp_path / "out"
    path.write_text(to_toml(crosser(schedule=schedule(1.2), height=-0.06)))
    main(["transition", str(path), "--out", str(out)])
    assert "above the water after" in capsys.readouterr().out
    record = json.loads((out / "transition.json").read_text())
    assert record["outcome"] == "goal" and record["experiment"]["transition"]["depth"] == 0.3
    rows = np.genfromtxt(out / "transition.csv", delimiter=",", names=True)
    assert rows["head_up_m"][-1] >= -0.06 > rows["head_up_m"][-2]
    assert (out / "transition.png").stat().st_size > 10_000
    assert (out / "transition.gif").stat().st_size > 10_000


def test_the_experiment_file_of_the_docs_is_the_built_in_robot():
    assert load(DOCS / "crossing.toml").model_dump() == example_crosser().model_dump()


def test_a_pressure_in_kPa_is_refused(tmp_path):
    path = tmp_path / "kilo.toml"
    text = (DOCS / "crossing.toml").read_text()
    path.write_text(text.replace("front = 172.3e3", "front = 172.3"))
    with pytest.raises(InputError, match="front: given 172.3; allowed 0, or 1000 to"):
        load(path)
