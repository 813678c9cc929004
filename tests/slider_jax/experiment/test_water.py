"""The table [water] of an experiment: stream, vortex street and gridded field."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rig.cli.shared import copy_experiment
from slider_jax.errors import InputError, SolverError
from slider_jax.experiment.load import load, to_model
from slider_jax.simulation.trial import simulate_trial
from slider_jax.swimming.gait import to_swimmer
from slider_jax.water import GriddedField, VortexStreet, karman_speed
from tests.support.experiments import write_small_experiment

STREET = "[water]\nvelocity = [-0.3, 0.0]\nvortex_street = { %s }\n"
KEYS = "spacing = 0.25, circulation = 0.04, core = 0.02"
GRID = '[water]\nfield = "wake.npz"\n'


def experiment(folder, water, *changes):
    return write_small_experiment(folder, ("[numerics]", f"{water}\n[numerics]"), *changes)


def write_field(folder, x=(-1.0, 1.0), y=(-0.5, 0.5), end=1.0, velocity=(-0.2, 0.05)):
    """Writes a uniform field on the ranges `x`, `y` [m] and 0 to `end` [s]."""
    t, x, y = np.linspace(0.0, end, 5), np.linspace(*x, 7), np.linspace(*y, 6)
    one = np.ones((5, 6, 7))
    content = dict(t_s=t, x_m=x, y_m=y, u_m_per_s=velocity[0] * one, v_m_per_s=velocity[1] * one)
    np.savez(folder / "wake.npz", **content)


def test_every_number_of_a_street_reaches_the_model(tmp_path):
    rest = "ratio = 0.3, advection = -0.2, position = [-0.1, 0.05]"
    path = experiment(tmp_path, STREET % f"{KEYS}, {rest}")
    expected = VortexStreet(0.25, 0.04, 0.02, (-0.3, 0.0), -0.2, (-0.1, 0.05), 0.3)
    assert jax.tree.leaves(to_model(load(path)).water) == jax.tree.leaves(expected)
    path = experiment(tmp_path, STREET % KEYS)
    own = to_model(load(path)).water.advection
    np.testing.assert_allclose(own, -0.3 + karman_speed(0.25, 0.04), rtol=1e-12)


@pytest.mark.slow
def test_a_uniform_field_of_a_file_acts_like_the_stream(tmp_path):
    write_field(tmp_path)
    in_field = simulate_trial(load(experiment(tmp_path, GRID)), 0).columns
    stream = experiment(tmp_path, "[water]\nvelocity = [-0.2, 0.05]\n")
    for name, x in simulate_trial(load(stream), 0).columns.items():
        np.testing.assert_allclose(in_field[name], x, atol=1e-8 * np.abs(x).max())


@pytest.mark.slow
def test_a_swimmer_is_carried_by_the_stream_and_disturbed_by_the_street(tmp_path):
    """Without a drive. Tolerance 0.01 m/s; the wake on the axis is more than 0.1 m/s slower."""
    idle = ("amplitude = 150000.0", "amplitude = 0.0")
    drag = '[[effects]]\nname = "tangential_friction"\nC_t = 3.0\n'
    longer = ("duration = 0.75", "duration = 1.2")
    free = ("tow_speed = 0.0", 'support = "free"\nstart_speed = -0.25')
    path = experiment(tmp_path, f"{STREET % KEYS}{drag}", idle, longer, free)
    calm = load(path).with_values({"water.vortex_street.circulation": 0.0})
    for each, same in ((calm, True), (load(path), False)):
        run = simulate_trial(each, 0)
        velocity = np.gradient(run.series["head"], run.t, axis=0)[-1]
        print(f"velocity {velocity}")
        off = np.abs(velocity - [-0.3, 0.0]).max()
        assert off < 0.01 if same else off > 0.1
    with pytest.raises(InputError, match="water: given a velocity field; .*slider simulate"):
        to_swimmer(to_model(load(path)))


def test_a_copy_of_an_experiment_contains_the_field(tmp_path):
    write_field(tmp_path)
    path = experiment(tmp_path, GRID)
    (tmp_path / "copy").mkdir()
    copy_experiment(path, tmp_path / "copy")
    assert isinstance(to_model(load(tmp_path / "copy" / "experiment.toml")).water, GriddedField)
    assert [x["path"] for x in load(path).profiles] == [str(tmp_path / "wake.npz")]


INVALID = {
    "street without core": (STREET % "spacing = 0.2, circulation = 0.04", "core: missing"),
    "unit": (STREET % KEYS.replace("0.25", "250.0"), "spacing: given 250.0; allowed 0.005 to 10 m"),
    "fast core": (STREET % KEYS.replace("0.02", "0.001"), r"core: given 0.001 m \(3.18 m/s\)"),
    "folder": ('[water]\nfield = "../wake.npz"\n', "field: given .*without folder, ending in .npz"),
    "ending": ('[water]\nfield = "wake.csv"\n', "field: given 'wake.csv'; .*ending in .npz"),
    "two fields": (
        f"{GRID}vortex_street = {{ {KEYS} }}\n",
        "vortex_street: given a value; .*field",
    ),
    "field in a stream": (
        f"{GRID}velocity = [0.1, 0.0]\n",
        "velocity: given a value; allowed noth",
    ),
}


@pytest.mark.parametrize("name", INVALID)
def test_an_invalid_table_gives_one_clear_error(name, tmp_path):
    text, message = INVALID[name]
    with pytest.raises(InputError, match=f"experiment.toml: water.*{message}"):
        load(experiment(tmp_path, text))


def test_a_field_must_exist_and_cover_the_trial_and_the_path_of_the_robot(tmp_path):
    path = experiment(tmp_path, GRID)
    with pytest.raises(InputError, match="wake.npz: no such file"):
        to_model(load(path))
    covers = {
        "x_m covers -0.3 to 1; allowed a field with -0.37 to 0,.*trial_00": dict(x=(-0.3, 1.0)),
        "y_m covers 0.1 to 1; allowed a field with": dict(y=(0.1, 1.0)),
        "t_s covers 0 to 0.7; allowed a field with 0 to 0.75, the duration": dict(end=0.7),
    }
    for message, changes in covers.items():
        write_field(tmp_path, **changes)
        with pytest.raises(InputError, match=message):
            to_model(load(path))
    write_field(tmp_path, x=(-0.4, 0.1))
    with pytest.raises(InputError, match="x_m covers -0.4 to 0.1; .* -0.37 to 0.18,.*trial_01"):
        to_model(load(path), 1)


@pytest.mark.slow
def test_a_robot_that_leaves_the_grid_stops_the_simulation(tmp_path):
    write_field(tmp_path, y=(-0.001, 0.001))
    free = ("tow_speed = 0.0", 'support = "free"')
    for changes in ((), (free,)):
        each = load(experiment(tmp_path, GRID, *changes))
        with pytest.raises(SolverError, match="trial_00.csv: the step .* give a larger field"):
            simulate_trial(each, 0)
    assert jnp.isnan(to_model(each).water.velocity(jnp.ones(2), jnp.zeros(()))).all()
