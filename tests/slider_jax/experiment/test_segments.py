"""Tests of robots with segments in an experiment file: the same robot written in several ways."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.beam.parameters import Numerics
from slider_jax.dynamics.statics import Loads
from slider_jax.errors import InputError
from slider_jax.experiment.load import load, to_model
from slider_jax.experiment.robot import RIGID, RIGID_FACTOR
from slider_jax.simulation.trial import simulate_trial
from slider_jax.sweep.sweep import Axis, Sweep
from tests.support.experiments import SMALL, write_small_experiment
from tests.support.helpers import static_state

KEYS = SMALL[SMALL.index("body_length") : SMALL.index("front_chamber")]
COMMON = "linear_density = 0.7\ndamping_time = 0.002\nheight = 0.03\n"


def segment(length, EI, part="body", more=""):
    return f'[[robot.segments]]\nlength = {length}\nEI = {EI}\npart = "{part}"\n{more}\n'


TAIL = segment(0.07, 0.0058, "tail")


def with_segments(folder, segments, common=COMMON):
    """Writes the small experiment with `segments` instead of a uniform body and tail."""
    path = write_small_experiment(
        folder, (KEYS, common), ("[parameters]", f"{segments}[parameters]")
    )
    return path


def thrust_of(path):
    return np.asarray(simulate_trial(load(path)).series["thrust"])


@pytest.mark.parametrize(
    "count", [1, 2, *(pytest.param(n, marks=pytest.mark.slow) for n in (5, 20))]
)
def test_a_body_in_equal_segments_is_the_uniform_body(tmp_path, count):
    uniform = thrust_of(write_small_experiment(tmp_path))
    cut = with_segments(tmp_path, count * segment(0.3 / count, 0.038) + TAIL)
    assert to_model(load(cut)).robot.body.lengths.shape == ((count,) if count > 1 else ())
    np.testing.assert_allclose(thrust_of(cut), uniform, rtol=1e-8, atol=1e-12)


def test_models_of_the_same_segments_have_the_same_structure(tmp_path):
    """A sweep stacks the models of its points, also if two segments are equal at one point."""
    models = [
        to_model(load(with_segments(tmp_path, segment(0.2, 0.038) + segment(0.1, EI) + TAIL)))
        for EI in (0.02, 0.038)
    ]
    shapes = [jax.tree.map(jnp.shape, x) for x in models]
    assert shapes[0] == shapes[1]


def test_a_constant_profile_gives_the_thrust_of_the_uniform_robot(tmp_path):
    uniform = thrust_of(write_small_experiment(tmp_path))
    rows = [(0.0, 0.038), (0.11, 0.038), (0.3, 0.038)]
    text = "s_m,EI_N_m2\n" + "".join(f"{s},{EI}\n" for s, EI in rows)
    (tmp_path / "body.csv").write_text(text)
    segments = '[[robot.segments]]\nlength = 0.3\nprofile = "body.csv"\n' + TAIL
    path = with_segments(tmp_path, segments)
    assert to_model(load(path)).robot.body.EI.shape == (2, 2)
    np.testing.assert_allclose(thrust_of(path), uniform, rtol=1e-8, atol=1e-11)


def test_a_rigid_segment_has_a_large_stiffness(tmp_path):
    stiff = "[[robot.segments]]\nlength = 0.05\nrigid = true\n"
    path = with_segments(tmp_path, stiff + segment(0.25, 0.038) + TAIL)
    body = to_model(load(path)).robot.body
    np.testing.assert_allclose(body.EI[:, 0], [RIGID_FACTOR * 0.038, 0.038])
    soft = to_model(load(with_segments(tmp_path, stiff + segment(0.25, 1e-5) + TAIL))).robot.body
    np.testing.assert_allclose(soft.EI[:, 0], [RIGID["EI"], 1e-5])
    np.testing.assert_allclose(body.lengths, [0.05, 0.25])


@pytest.mark.slow
def test_a_robot_bends_behind_its_rigid_segment_as_if_it_were_clamped_there(tmp_path):
    """The tip's displacement is F l^3/(3 EI), with the length l of the flexible part."""
    stiff = "[[robot.segments]]\nlength = 0.1\nrigid = true\n"
    path = with_segments(tmp_path, stiff + segment(0.2, 0.038) + segment(0.07, 0.038, "tail"))
    force = 0.002
    loads = Loads(jnp.array([0.0, force]), jnp.zeros(2))
    mesh = Numerics(tail_cells=30, body_cells=120)
    found = static_state(to_model(load(path)), loads, mesh)
    assert bool(found.ok)
    assert float(found.shape[1, 0]) == pytest.approx(force * 0.27**3 / (3.0 * 0.038), rel=1e-3)


@pytest.mark.slow
def test_a_robot_may_have_no_tail(tmp_path):
    path = with_segments(tmp_path, segment(0.3, 0.038))
    assert float(to_model(load(path)).robot.length) == 0.3
    assert np.isfinite(thrust_of(path)).all()


def test_a_point_mass_reaches_the_model(tmp_path):
    mass = "[[robot.point_masses]]\ns = 0.3\nmass = 0.04\n"
    robot = to_model(load(with_segments(tmp_path, segment(0.3, 0.038) + TAIL + mass))).robot
    assert float(robot.mass) == pytest.approx(0.7 * 0.37 + 0.04)


CASES = {
    "tail before the body": (
        segment(0.2, 0.038) + TAIL + segment(0.1, 0.038),
        COMMON,
        'robot.segments.2.part: given "body"; allowed "tail", because the segment before',
    ),
    "no body": (TAIL, COMMON, 'robot.segments.0.part: given "tail"; allowed "body"'),
    "no stiffness": (
        "[[robot.segments]]\nlength = 0.3\n",
        COMMON,
        "robot.segments.0.EI: given nothing; allowed a number here, in [robot]",
    ),
    "no height": (
        segment(0.3, 0.038),
        COMMON.replace("height = 0.03\n", ""),
        "robot.segments.0.height: given nothing",
    ),
    "millimetres": (segment(300.0, 0.038), COMMON, "robot.segments.0.length: given 300.0; allowed"),
    "unknown key": (
        segment(0.3, 0.038, more="EI_body = 1.0"),
        COMMON,
        "robot.segments.0.EI_body: unknown key",
    ),
    "keys of both kinds": (
        segment(0.3, 0.038),
        COMMON + "body_length = 0.3\n",
        "robot.body_length: unknown key",
    ),
    "missing length": (
        "[[robot.segments]]\nEI = 0.04\n",
        COMMON,
        "robot.segments.0.length: missing",
    ),
    "unknown part": (
        segment(0.3, 0.038, "head"),
        COMMON,
        "robot.segments.0.part: given 'head'; allowed 'body' or 'tail'",
    ),
    "chamber beyond the body": (
        segment(0.2, 0.038) + TAIL,
        COMMON,
        "robot.rear_chamber: given [0.155, 0.28]; allowed spans within the body, 0 to 0.2 m",
    ),
    "mass beyond the robot": (
        segment(0.3, 0.038) + TAIL + "[[robot.point_masses]]\ns = 0.4\nmass = 0.1\n",
        COMMON,
        "robot.point_masses.0.s: given 0.4; allowed 0 to 0.37 m",
    ),
    "stiffness of a rigid segment": (
        segment(0.3, 0.5, more="rigid = true") + TAIL,
        COMMON,
        "robot.segments.0.EI: given a number; allowed nothing, because the segment is rigid",
    ),
    "number for a boolean": (
        "[[robot.segments]]\nlength = 0.3\nrigid = 1\n",
        COMMON,
        "robot.segments.0.rigid: given 1; input should be a valid boolean",
    ),
    "NaN": (segment("nan", 0.038), COMMON, "robot.segments.0.length: given nan"),
}


@pytest.mark.parametrize("name", CASES)
def test_an_invalid_segment_is_named(tmp_path, name):
    segments, common, message = CASES[name]
    with pytest.raises(InputError) as error:
        load(with_segments(tmp_path, segments, common))
    assert message in str(error.value)


PROFILES = {
    "short": ("s_m,EI_N_m2\n0,0.03\n0.2,0.03\n", "s_m covers 0 to 0.2 m; allowed 0 to 0.3 m"),
    "one row": ("s_m,EI_N_m2\n0,0.03\n", "1 rows under the header; at least 2 are needed"),
    "backwards": ("s_m,EI_N_m2\n0,0.03\n0.3,0.03\n0.2,0.03\n", "the distance must increase"),
    "NaN": ("s_m,EI_N_m2\n0,0.03\n0.2,\n0.3,0.03\n", "line 3, column EI_N_m2: given nan"),
    "wrong unit": ("s_m,EI_N_m2\n0,3e4\n0.3,3e4\n", "column EI_N_m2: given 30000; allowed 1e-06"),
    "misspelt column": (
        "s_m,EI_Nm2\n0,0.03\n0.3,0.03\n",
        "unknown column EI_Nm2; allowed columns: s_m, linear_density_kg_per_m, EI_N_m2",
    ),
    "no property": ("s_m\n0\n0.3\n", "no property; allowed columns: s_m"),
    "no column": ("s_m,height_m\n0,0.03\n0.3,0.03\n", "no column EI_N_m2; add this column"),
    "column and number": (
        "s_m,EI_N_m2,linear_density_kg_per_m\n0,0.03,0.7\n0.3,0.03,0.7\n",
        "column linear_density_kg_per_m: the segment also has linear_density = 0.5",
    ),
}


@pytest.mark.parametrize("name", PROFILES)
def test_an_invalid_profile_is_named(tmp_path, name):
    text, message = PROFILES[name]
    (tmp_path / "body.csv").write_text(text)
    own = "linear_density = 0.5\n" if name == "column and number" else ""
    segments = f'[[robot.segments]]\nlength = 0.3\n{own}profile = "body.csv"\n{TAIL}'
    with pytest.raises(InputError) as error:
        to_model(load(with_segments(tmp_path, segments)))
    assert "body.csv" in str(error.value) and message in str(error.value)


def test_an_experiment_without_robot_names_the_keys(tmp_path):
    text = SMALL[: SMALL.index("[robot]")] + SMALL[SMALL.index("[parameters]") :]
    (tmp_path / "e.toml").write_text(text)
    with pytest.raises(InputError, match=r"robot: missing; add a table \[robot\] with .*EI_body"):
        load(tmp_path / "e.toml")


def test_a_changed_profile_is_another_input_of_a_sweep(tmp_path):
    """Otherwise, a sweep would resume with results of the earlier profile."""
    segments = f'[[robot.segments]]\nlength = 0.3\nprofile = "body.csv"\n{TAIL}'
    path, settings = with_segments(tmp_path, segments), []
    for EI in (0.03, 0.04):
        (tmp_path / "body.csv").write_text(f"s_m,EI_N_m2\n0,{EI}\n0.3,{EI}\n")
        axis = Axis("trials.0.frequency", (2.0, 3.0))
        settings.append(Sweep(load(path), (axis,)).settings())
    assert settings[0]["profiles"] != settings[1]["profiles"]


def test_a_missing_profile_is_named(tmp_path):
    segments = f'[[robot.segments]]\nlength = 0.3\nprofile = "none.csv"\n{TAIL}'
    with pytest.raises(InputError, match="none.csv"):
        to_model(load(with_segments(tmp_path, segments)))
