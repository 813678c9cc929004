"""Shapes of a trial: their files, exports, the interactive view and the picture of midlines."""

import base64
import json
import re
import sys
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slider_jax.cli.main import main
from slider_jax.errors import InputError
from slider_jax.experiment.load import load
from slider_jax.experiment.prepare import prepare
from slider_jax.simulation import plots
from slider_jax.simulation.shape import SavedShape, read_shape, saved_shape, write_shape, write_vtk
from slider_jax.simulation.trial import TrialRun, simulate_trial
from slider_jax.simulation.view import view_data, write_view
from tests.support.experiments import write_small_experiment

IN_SPACE = (
    ('name = "small"', 'name = "small"\ndimension = 3'),
    ("height = 0.03", "height = 0.03\nGJ_body = 0.03\nGJ_tail = 0.003\npolar_inertia = 6e-5"),
    ("[[trials]]", '[[trials]]\nsupport = "free"'),
    ("tow_speed = 0.0", "roll = 0.4"),
)
ROLL = 0.4
LENGTH = 0.37


def rolled_arc(folder, *changes, dimension=3):
    """A free robot that bends to arcs in a plane that is rolled about x, without simulation."""
    file = write_small_experiment(
        folder, *(IN_SPACE if dimension == 3 else IN_SPACE[2:3]), *changes
    )
    prepared = prepare(load(file, spatial=True), 0)
    run = TrialRun(prepared, {}, {}, 0)
    t, nodes = run.t, prepared.numerics.tail_cells + prepared.numerics.body_cells + 1
    s = np.linspace(-LENGTH, 0.0, nodes)
    curvature = 4.0 * np.sin(2.0 * np.pi * 4.0 * t)[:, None]
    angle = curvature * s + 1e-9
    roll = Rotation.from_rotvec([ROLL if dimension == 3 else 0.0, 0.0, 0.0])
    # sin(a)/a and (1 - cos(a))/a for the angle a = curvature s
    arc = np.stack([s * np.sin(angle) / angle, s * (1.0 - np.cos(angle)) / angle, 0.0 * angle], -1)
    turn = np.stack([0.0 * angle, 0.0 * angle, angle], -1)
    frames = roll * Rotation.from_rotvec(turn.reshape(-1, 3))
    quaternions = np.roll(frames.as_quat(), 1, axis=1).reshape(*angle.shape, 4)
    midline = np.moveaxis(roll.apply(arc.reshape(-1, 3)).reshape(arc.shape), 2, 1)
    force = 2.0 * np.diff(midline, axis=2)
    head = np.stack([0.3 * t, 0.1 * t, 0.05 * t], axis=1)
    run.series.update(
        midline=midline[:, :dimension],
        force=force[:, :dimension],
        head=head[:, :dimension],
        moment=0.01 * angle,
        frame=np.moveaxis(quaternions, 2, 1),
    )
    return run, frames.as_matrix().reshape(*angle.shape, 3, 3)


@pytest.fixture(scope="module")
def arc(tmp_path_factory):
    return rolled_arc(tmp_path_factory.mktemp("arc"))


def unpacked(x):
    whole = np.frombuffer(base64.b64decode(x["text"]), "<i2")
    return x["unit"] * whole.reshape(x["shape"])


def test_axes_of_the_sections_are_the_columns_of_their_rotations(arc):
    run, rotations = arc
    expected = np.moveaxis(rotations, (1, 2, 3), (3, 2, 1))  # (steps, axis, 3, nodes)
    np.testing.assert_allclose(saved_shape(run).axes(), expected, atol=1e-14)


def test_a_shape_file_returns_what_was_written(arc, tmp_path):
    shape, path = saved_shape(arc[0]), tmp_path / "x_shape.npz"
    write_shape(shape, {"name": "arc", "speed": np.inf}, path)
    back, info = read_shape(path)
    for name, values in shape._asdict().items():
        np.testing.assert_array_equal(getattr(back, name), values, err_msg=name)
    assert info["name"] == "arc" and info["speed"] is None
    assert set(info["definitions"]) == set(SavedShape._fields)


def test_a_planar_shape_has_three_components(tmp_path):
    shape = saved_shape(rolled_arc(tmp_path, dimension=2)[0])
    for vectors in (shape.midline_m, shape.head_m, shape.force_N_per_m):
        assert vectors.shape[1] == 3 and not vectors[:, 2].any()
    clamped = rolled_arc(tmp_path, dimension=2)[0]
    del clamped.series["head"]
    assert not saved_shape(clamped).head_m.any()


def test_a_file_that_is_no_shape_is_refused(arc, tmp_path, capsys):
    shape = saved_shape(arc[0])
    text, other, cut = (tmp_path / f"{name}.npz" for name in ("text", "other", "cut"))
    text.write_text("t_s,p_front_Pa")
    np.savez(other, t_s=shape.t_s)
    write_shape(shape._replace(frame=shape.frame[:, :3]), {}, cut)
    for path, problem in (
        (tmp_path / "none.npz", "no such file; give a file that `slider simulate --shape` wrote"),
        (tmp_path, "not a readable shape file"),
        (text, "not a readable shape file (.npz); give a file"),
        (other, "no array midline_m; give a file"),
        (cut, "frame: given an array (151, 3, 11) of type float64; allowed numbers (151, 4, 11)"),
    ):
        with pytest.raises(InputError, match=f"^{re.escape(str(path))}.*{re.escape(problem)}"):
            read_shape(path)
    assert main(["export", str(cut), "--every", "0", "--out", str(tmp_path / "out")]) == 2
    assert "--every: given 0; allowed 1 or more" in capsys.readouterr().err
    assert main(["export", str(cut), "--to", "stl", "--out", str(tmp_path / "out")]) == 2
    assert "--to: given 'stl'; allowed vtk, rerun" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_vtk_files_contain_the_shape(arc, tmp_path):
    """To the seven digits of the files."""
    shape, source, out = saved_shape(arc[0]), tmp_path / "arc_shape.npz", tmp_path / "out"
    write_shape(shape, {}, source)
    assert main(["export", str(source), "--to", "vtk", "--every", "50", "--out", str(out)]) == 0
    index = ElementTree.parse(out / "arc_shape.pvd").findall("Collection/DataSet")
    assert [float(x.get("timestep")) for x in index] == shape.t_s[::50].tolist()
    steps = {0, 50, 100, 150}
    assert {x.name for x in out.glob("*.vtp")} == {f"arc_shape_{i:06d}.vtp" for i in steps}
    piece = ElementTree.parse(out / index[2].get("file")).find("PolyData/Piece")
    arrays = {x.get("Name"): np.array(x.text.split(), float) for x in piece.iter("DataArray")}
    tau, n, b = shape.axes()[100]
    position = shape.midline_m[100] + shape.head_m[100][:, None]
    for name, values in {
        "position_m": position, "tau": tau, "n": n, "b": b,
        "moment_N_m": shape.moment_N_m[100], "force_N_per_m": shape.force_N_per_m[100],
    }.items():  # fmt: skip
        np.testing.assert_allclose(arrays[name], np.ravel(values.T), atol=1e-7, err_msg=name)
    assert (piece.get("NumberOfPoints"), piece.get("NumberOfLines")) == ("11", "10")
    np.testing.assert_array_equal(
        arrays["connectivity"].reshape(-1, 2), [[i, i + 1] for i in range(10)]
    )
    np.testing.assert_array_equal(arrays["offsets"], np.arange(2, 22, 2))


def test_an_export_for_rerun_without_the_package_says_how_to_install_it(
    arc, tmp_path, monkeypatch, capsys
):
    monkeypatch.setitem(sys.modules, "rerun", None)  # An import then raises ImportError.
    source, out = tmp_path / "arc_shape.npz", tmp_path / "out"
    write_shape(saved_shape(arc[0]), {}, source)
    assert main(["export", str(source), "--to", "rerun", "--out", str(out)]) == 2
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1 and "pip install -e .[rerun]" in printed
    assert not out.exists()


def test_a_recording_for_rerun_contains_the_shape(arc, tmp_path):
    """To the seven digits of single precision."""
    reason = "rerun-sdk (a wheel of 170 MB) is not installed"
    pytest.importorskip("rerun", reason=reason, exc_type=ImportError)
    from rerun.chunk import RrdReader

    shape, source, out = saved_shape(arc[0]), tmp_path / "arc_shape.npz", tmp_path / "out"
    write_shape(shape, {}, source)
    assert main(["export", str(source), "--to", "rerun", "--every", "50", "--out", str(out)]) == 0
    assert [x.name for x in out.iterdir()] == ["arc_shape.rrd"]
    found = {}
    for chunk in RrdReader(out / "arc_shape.rrd").stream():
        rows = chunk.to_record_batch().to_pydict()
        for name, values in rows.items():
            found[chunk.entity_path, name.split(":")[-1]] = values
    steps, nodes = slice(None, None, 50), np.arange(11)
    position = np.swapaxes(shape.position_m[steps], 1, 2)  # (steps, nodes, 3)
    axes = shape.axes()[steps].transpose(0, 3, 1, 2)  # (steps, nodes, axis, 3)
    force = np.swapaxes(shape.force_N_per_m[steps], 1, 2)

    def check(entity, name, expected):
        values = np.array(found[f"/robot/{entity}", name])
        np.testing.assert_allclose(values.reshape(expected.shape), expected, atol=1e-7)

    for entity in ("midline", "frames", "forces"):
        seconds = [x.total_seconds() for x in found[f"/robot/{entity}", "time"]]
        np.testing.assert_allclose(seconds, shape.t_s[steps], atol=1e-9)
    check("midline", "strips", position)
    check("frames", "origins", np.repeat(position[:, nodes, None], 3, axis=2))
    check("frames", "vectors", 0.05 * LENGTH * axes)
    check("forces", "origins", (position[:, 1:] + position[:, :-1]) / 2)
    scale = found["/robot/forces", "metres_per_N_per_m"][0][0]
    check("forces", "vectors", scale * force)
    longest = np.linalg.norm(scale * force, axis=2).max()
    np.testing.assert_allclose(longest, 0.2 * LENGTH, rtol=1e-9)


def test_a_view_contains_positions_frames_forces_and_heights(arc):
    run, rotations = arc
    data, shape = view_data(run), saved_shape(run)
    np.testing.assert_allclose(data["times"], 1e3 * run.t, atol=1e-3)
    for name, values in {
        "position": 1e3 * shape.position_m,
        "b": np.swapaxes(rotations[..., 2], 1, 2),
        "force": shape.force_N_per_m,
        "height": np.full(10, 30.0),
    }.items():
        largest = np.abs(values).max()
        np.testing.assert_allclose(unpacked(data[name]), values, atol=largest / 65000, err_msg=name)
    assert data["head"] == "head"


def test_a_view_is_small_and_needs_no_network(tmp_path):
    changes = ("nodes = 11", "nodes = 301"), ("duration = 0.75", "duration = 9.0")
    run = rolled_arc(tmp_path, *changes)[0]
    path = write_view(run, tmp_path)
    assert path.name == "trial_00_view.html" and path.stat().st_size < 1_500_000
    page = path.read_text()
    assert not re.search(r"https?:|@import|<script[^>]*src|<link[^>]*stylesheet", page)
    data = json.loads(re.search(r'id="data">(.*?)</script>', page)[1])
    assert data["times"][-1] == pytest.approx(9000.0) and len(data["times"]) == 301
    # 15 strides of 0.25 s
    assert data["times"][0] == pytest.approx(5250.0)
    ends = unpacked(data["position"])[:, :, [0, -1]]
    expected = 1e3 * saved_shape(run).position_m[:, :, [0, -1]][-1]
    np.testing.assert_allclose(ends[-1], expected, atol=1e-4 * np.abs(expected).max())


def test_a_view_of_a_planar_trial_lies_in_the_plane(tmp_path):
    data = view_data(rolled_arc(tmp_path, dimension=2)[0])
    assert not unpacked(data["position"])[:, 2].any()
    np.testing.assert_allclose(unpacked(data["b"])[:, 2], 1.0, atol=1e-12)


@pytest.mark.parametrize("dimension", [2, 3])
def test_midlines_are_drawn_from_above_and_in_space_also_from_the_side(
    dimension, tmp_path, monkeypatch
):
    figures = []
    monkeypatch.setattr(plots, "save_figure", lambda figure, path: figures.append(figure))
    run = rolled_arc(tmp_path, dimension=dimension)[0]
    plots.plot_midlines(run, tmp_path / "x.png")
    *panels, _ = figures[0].axes  # the last one is the colour bar
    assert [x.get_ylabel()[0] for x in panels] == ["y", "z"][: dimension - 1]
    steps = plots.last_strides(run, 16)
    for axis, panel in enumerate(panels, start=1):
        for line, step in zip(panel.get_lines(), steps, strict=False):
            expected = 1e3 * run.series["midline"][step][[0, axis]]
            np.testing.assert_allclose(line.get_data(), expected)


@pytest.mark.slow
def test_frames_of_a_simulated_robot_in_space_belong_to_its_midline(tmp_path):
    """tau is the tangent: against the chord over two cells of a smooth shape to 2 %."""
    file = write_small_experiment(tmp_path, *IN_SPACE, ("nodes = 11", "nodes = 21"))
    run = simulate_trial(load(file, spatial=True), 0, shape=True)
    shape = saved_shape(run)
    tau, _, b = np.moveaxis(shape.axes(), 1, 0)
    chord = shape.midline_m[:, :, 2:] - shape.midline_m[:, :, :-2]
    chord /= np.linalg.norm(chord, axis=1, keepdims=True)
    np.testing.assert_allclose(tau[:, :, 1:-1], chord, atol=0.02)
    np.testing.assert_allclose(b[0].T, np.tile([0.0, -np.sin(ROLL), np.cos(ROLL)], (21, 1)))
    norm = np.linalg.norm(shape.frame, axis=1)
    np.testing.assert_allclose(norm, 1.0, atol=1e-12)
    assert np.abs(shape.midline_m[:, 2]).max() > 1e-3
    write_vtk(shape, "x", tmp_path, every=100)
    write_view(run, tmp_path)
