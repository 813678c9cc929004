"""Experiment files of robots in three dimensions: the model, and input that is refused."""

import copy
import tomllib
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.beam.parameters import Numerics
from slider_jax.errors import InputError
from slider_jax.experiment.load import assemble, load, to_model
from slider_jax.spatial.mesh import spatial_mesh

PARAMETERS = """[parameters]
C_d = 3.0
m_a = 1.0
k = 0.087
K_Q = 4.79e-7
"""
FILE = f"""
name = "strip"
dimension = 3
[robot]
body_length = 0.298
tail_length = 0.07
linear_density = 0.7
EI_body = 0.038
EI_tail = 0.0058
EI_n_tail = 0.5
GJ_body = 0.03
GJ_tail = 0.003
polar_inertia = 6e-5
width = 0.02
damping_time = 0.002
height = 0.03
[[actuators]]
kind = "pneumatic"
name = "front"
span = [0.02, 0.145]
angle = 0.4
{PARAMETERS}[[trials]]
file = "still.csv"
frequency = 2.0
amplitude = 1e5
roll = 0.3
duration = 1.0
"""
SEGMENTS = f"""
name = "segments"
dimension = 3
[robot]
polar_inertia = 6e-5
damping_time = 0.002
height = 0.03
EI = 0.04
linear_density = 0.7
[[robot.segments]]
length = 0.2
GJ = 0.03
[[robot.segments]]
length = 0.1
part = "tail"
GJ = 0.01
EI_n = 0.3
{PARAMETERS}[[trials]]
file = "still.csv"
frequency = 2.0
duration = 1.0
"""


def experiment(text=FILE, **changes):
    content = copy.deepcopy(tomllib.loads(text))
    for path, value in changes.items():
        *parents, last = path.split("__")
        table = content
        for part in parents:
            table = table[int(part) if part.isdigit() else part]
        if value is None:
            del table[last]
        else:
            table[last] = value
    return assemble(content, "file.toml", Path("."))


def test_the_model_has_the_properties_of_the_file(tmp_path):
    (tmp_path / "strip.toml").write_text(FILE)
    model = to_model(load(tmp_path / "strip.toml", spatial=True))
    np.testing.assert_allclose(model.space.angles, [0.4])
    assert float(model.space.roll) == 0.3
    mesh = spatial_mesh(model.body, Numerics(tail_cells=4, body_cells=8))
    stiffness = np.array(jnp.stack(mesh.structure.stiffness))
    np.testing.assert_allclose(stiffness[:, 0], [0.003, 0.5, 0.0058])
    np.testing.assert_allclose(stiffness[:, -1], [0.03, 0.038, 0.038])
    np.testing.assert_allclose(mesh.structure.inertia.tau, 6e-5)
    np.testing.assert_allclose(mesh.structure.width, 0.02)


def test_tendons_and_helical_chambers_have_their_angles():
    model = to_model(experiment())
    assert model.space.distances is None and model.space.far_angles is None
    front = {"kind": "pneumatic", "name": "front", "span": [0.02, 0.14], "angle": 0.4}
    rear = front | {"name": "rear", "span": [0.15, 0.28], "angle": [0.1, -2.0], "distance": 0.02}
    helix = TENDON | {"angle": [0.0, 3.0], "offset": [0.01, 0.02]}
    model = to_model(experiment(actuators=[front, rear, helix]))
    np.testing.assert_allclose(model.space.angles, [0.4, 0.1])
    np.testing.assert_allclose(model.space.far_angles, [0.4, -2.0])
    np.testing.assert_allclose(model.space.distances, [0.0, 0.02])
    (tendon,) = model.actuators
    np.testing.assert_allclose(tendon.angle_at(jnp.array([0.02, 0.2])), [0.0, 3.0], atol=1e-15)
    assert float(tendon.angle_rate) == pytest.approx(-3.0 / 0.18)


def test_segments_have_their_own_torsional_stiffness(tmp_path):
    (tmp_path / "segments.toml").write_text(SEGMENTS)
    robot = to_model(load(tmp_path / "segments.toml", spatial=True)).body
    structure = spatial_mesh(robot, Numerics(tail_cells=4, body_cells=8)).structure
    np.testing.assert_allclose(np.array(structure.stiffness.tau)[[0, -1]], [0.01, 0.03])
    np.testing.assert_allclose(np.array(structure.stiffness.n)[[0, -1]], [0.3, 0.04])
    assert float(jnp.max(structure.width)) == 0.0


TENDON = {"kind": "tendon", "name": "left", "span": [0.02, 0.2], "offset": 0.01, "tension": 1.0}
WAVE = {"kind": "shape", "name": "w", "span": [0.0, 0.2], "wavelength": 1.0, "amplitude": [1, 0, 0]}
BAD = [
    ({"dimension": 4}, "dimension: given 4"),
    ({"dimension": 1}, "dimension: given 1"),
    ({"dimension": "3"}, "dimension: given '3'"),
    ({"dimension": 2}, r"actuators.0.angle: given 0.4; allowed 0, unless dimension is 3"),
    (
        {"dimension": 2, "actuators__0__angle": None},
        r"trials.0.roll: given 0.3; allowed 0, unless dimension is 3",
    ),
    ({"robot__GJ_body": None}, "robot.GJ_body: given nothing; allowed a number"),
    ({"robot__GJ_tail": None}, "robot.GJ_tail: given nothing; allowed a number"),
    ({"robot__polar_inertia": None}, "robot.polar_inertia: given nothing; allowed a number"),
    ({"robot__GJ_body": 0.0}, "robot.GJ_body"),
    ({"robot__GJ_tail": -1.0}, "robot.GJ_tail"),
    ({"robot__GJ_tail": float("nan")}, "robot.GJ_tail"),
    ({"robot__polar_inertia": 0.0}, "robot.polar_inertia"),
    ({"robot__polar_inertia": "6e-5"}, "robot.polar_inertia"),
    ({"robot__EI_n_tail": -0.5}, "robot.EI_n_tail"),
    ({"robot__EI_n_body": float("inf")}, "robot.EI_n_body"),
    ({"robot__width": 20.0}, "robot.width"),
    ({"robot__width": -0.01}, "robot.width"),
    ({"robot__GJ": 0.03}, "robot.GJ"),
    ({"actuators__0__angle": 90.0}, "actuators.0.angle"),
    ({"actuators__0__angle": float("nan")}, "actuators.0.angle"),
    ({"actuators__0__stiffening": 1e-8}, "actuators.0.stiffening: given 1e-08; allowed 0"),
    (
        {"actuators": [WAVE], "trials__0__amplitude": None},
        'actuators.0.kind: given \'shape\'; allowed "pneumatic" or "tendon", as dimension is 3',
    ),
    ({"actuators__0__angle": [0.0, 1.0]}, "actuators.0.distance: given nothing; allowed a length"),
    ({"actuators__0__angle": [0.0, 1.0, 2.0]}, "actuators.0.angle"),
    ({"actuators__0__distance": 0.0}, "actuators.0.distance"),
    (
        {"dimension": 2, "actuators__0__angle": None, "actuators__0__distance": 0.01},
        "actuators.0.distance: given 0.01; allowed nothing, unless dimension is 3",
    ),
    (
        {
            "dimension": 2,
            "actuators": [TENDON | {"angle": [0.0, 1.0]}],
            "trials__0__amplitude": None,
        },
        r"actuators.0.angle: given \[0.0, 1.0\]; allowed 0, unless dimension is 3",
    ),
    ({"actuators": [TENDON | {"angle": 90.0}]}, "actuators.0.angle"),
    ({"actuators": [TENDON | {"distance": 0.01}]}, "actuators.0.distance"),
    ({"trials__0__roll": 30.0}, "trials.0.roll"),
    ({"effects": [{"name": "tail_stiffness"}]}, "effects.0.name: given 'tail_stiffness', which is"),
    ({"effects": [{"name": "gravity", "elevation": "up"}]}, "effects.0.elevation"),
    ({"effects": [{"name": "gravity", "g": 9.81}]}, "effects.0.elevation: missing; with dimension"),
    (
        {"effects": [{"name": "gravity", "elevation": 1.5708, "buoyancy_b": 0.005}]},
        "effects.0.buoyancy_b: given 0.005, but the robot displaces no water",
    ),
    ({"water": {"field": "field.npz"}}, "water.field: given a velocity field; allowed nothing"),
]


@pytest.mark.parametrize(("changes", "message"), BAD, ids=str)
def test_bad_input_is_refused_with_the_key(changes, message):
    with pytest.raises(InputError, match=message) as error:
        experiment(**changes)
    assert "\n" not in str(error.value).strip()


def test_a_segment_without_torsional_stiffness_is_named():
    with pytest.raises(InputError, match=r"robot.segments.1.GJ: given nothing; allowed a number"):
        experiment(SEGMENTS, robot__segments__1__GJ=None)


MARKER = {"kind": "marker", "name": "fin", "s": 0.3, "columns": ["X_m", "Y_m", "Z_m"]}


def test_a_marker_has_three_coordinates_in_space_only():
    channels = experiment(sensors={"channels": [MARKER]}).channels
    assert channels.columns[-3:] == ("X_m", "Y_m", "Z_m")
    flat = {"dimension": 2, "actuators__0__angle": None, "trials__0__roll": None}
    with pytest.raises(InputError, match="sensors.channels.0.columns: .* unless dimension is 3"):
        experiment(sensors={"channels": [MARKER]}, **flat)


def test_a_planar_file_may_give_torsional_stiffness_for_some_segments_only():
    robot = experiment(SEGMENTS, dimension=2, robot__segments__1__GJ=None).robot_model()
    assert robot.body.GJ is None and robot.tail.GJ is None


def test_a_rigid_segment_is_stiff_against_torsion(tmp_path):
    rigid = SEGMENTS.replace("length = 0.2\nGJ = 0.03", "length = 0.2\nrigid = true")
    (tmp_path / "rigid.toml").write_text(rigid)
    robot = to_model(load(tmp_path / "rigid.toml", spatial=True)).body
    structure = spatial_mesh(robot, Numerics(tail_cells=4, body_cells=8)).structure
    np.testing.assert_allclose(np.array(structure.stiffness.tau)[[0, -1]], [0.01, 100.0])


def test_planar_commands_refuse_three_dimensions(tmp_path):
    (tmp_path / "strip.toml").write_text(FILE)
    with pytest.raises(InputError, match=r"strip.toml: dimension: given 3; allowed 2"):
        load(tmp_path / "strip.toml")
