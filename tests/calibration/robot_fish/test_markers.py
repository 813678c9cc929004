"""Reading of the robot fish's markers, and the definition of its speed."""

import json

import numpy as np
import pytest

from calibration.robot_fish.markers import (
    COLUMNS,
    behind_head,
    first_harmonic,
    lateral_motion,
    read_marker_runs,
    rotated,
    steady_speed_of,
)
from slider_jax.errors import InputError


def swimming(speed=0.12, beat=1.0, yaw=0.1, turn=0.0, frames=301):
    """Markers of a straight rigid fish that swims to the left, yaws and turns."""
    t = np.arange(frames) / 60.0
    heading = np.pi + turn * t + yaw * np.sin(2.0 * np.pi * beat * t)
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    path = np.cumsum(np.concatenate([[[0.0, 0.0]], speed / 60.0 * ahead[1:]]), axis=0)
    places = np.array([-0.077, 0.065, 0.28, 0.2995, 0.3295, 0.3615, 0.3905, 0.4115, 0.474])
    return t, path[:, None] - (places - places[:2].mean())[:, None] * ahead[:, None]


def write_run(folder, name="a", beat=1.0, frames=301, edit=lambda lines: lines):
    t, markers = swimming(beat=beat, frames=frames)
    table = np.column_stack([t, (markers * [1.0, -1.0]).reshape(len(t), -1)])
    lines = [",".join(("t_s", *COLUMNS)), *(",".join(f"{x:.6f}" for x in row) for row in table)]
    folder.mkdir(exist_ok=True)
    (folder / f"{name}_lab.csv").write_text("\n".join(edit(lines)) + "\n")
    (folder / "beats.json").write_text(json.dumps({name: beat}))


def test_speed_is_progress_along_the_momentary_heading():
    """A course that bends and yaws has the speed along its own path, not that of its chord."""
    t, markers = swimming(speed=0.12, yaw=0.3, turn=0.2)
    assert steady_speed_of(t, markers) == pytest.approx(0.12, rel=1e-9)
    chord = np.linalg.norm(markers[-1, 0] - markers[0, 0]) / t[-1]
    assert chord < 0.115


def test_harmonic_of_a_drifting_signal_is_exact():
    t = np.arange(250) / 60.0
    x = 1.0 + 2.0 * t - t**2 + np.real((0.3 - 0.4j) * np.exp(2j * np.pi * 0.75 * t))
    assert first_harmonic(t, x, 0.75) == pytest.approx(0.3 - 0.4j, abs=1e-9)


def test_lateral_motion_is_positive_to_the_left_of_a_leftward_course():
    t, markers = swimming(yaw=0.05)
    found = lateral_motion(t, markers, 1.0)
    assert abs(found.yaw) == pytest.approx(0.05, rel=1e-3)
    assert np.angle(found.yaw, deg=True) == pytest.approx(-90.0, abs=1.0)
    lever = (found.sway[8] - found.sway[1]) / found.yaw
    assert lever.real == pytest.approx(-(0.474 - 0.065), rel=0.01)
    np.testing.assert_allclose(behind_head(markers), 0.0, atol=1e-12)


def test_the_published_speeds_and_rotated_markers(data):
    """Tolerances: the data's README gives 4 digits of the speeds and 4e-6 m for the markers."""
    folder = data / "fishsim"
    if not folder.is_dir():
        pytest.skip("the robot fish is absent; set SLIDER_DATA to a folder with fishsim/")
    speeds = {x.name: x.speed for x in read_marker_runs(folder)}
    assert speeds == pytest.approx({"f1_00": 0.0809, "f1_75": 0.1613}, abs=5e-5)
    for x in read_marker_runs(folder):
        table = np.loadtxt(folder / f"{x.name}_rotated.csv", delimiter=",", skiprows=1)
        published = table[:, 1:].reshape(len(table), 9, 2)
        np.testing.assert_allclose(rotated(x.markers) * [1.0, -1.0], published, atol=5e-6)


def test_the_measured_recoil(data):
    """The README's amplitudes are those of a first harmonic across the mean course."""
    folder = data / "fishsim"
    if not folder.is_dir():
        pytest.skip("the robot fish is absent; set SLIDER_DATA to a folder with fishsim/")
    slow, fast = read_marker_runs(folder)
    for x, amplitudes, yaw in (
        (slow, (21.0, 16.0, 36.8, 49.6), 7.55),
        (fast, (12.7, 8.7, 25.8, 60.2), 5.99),
    ):
        found = lateral_motion(x.t, x.markers, x.beat)
        np.testing.assert_allclose(1e3 * np.abs(found.sway[[0, 1, 2, 8]]), amplitudes, rtol=0.03)
        assert np.degrees(abs(found.yaw)) == pytest.approx(yaw, rel=0.01)


def test_other_files_are_refused_with_one_error(tmp_path):
    run = tmp_path / "runs"

    def error():
        with pytest.raises(InputError) as caught:
            read_marker_runs(run)
        return str(caught.value)

    assert "no such folder" in error()
    run.mkdir()
    assert "beats.json: no such file" in error()
    (run / "beats.json").write_text("{")
    assert "not JSON" in error()
    (run / "beats.json").write_text('{"a": -1}')
    assert "0.05 to 10 Hz" in error()
    (run / "beats.json").write_text('{"b": 1.0}')
    assert "no file NAME_lab.csv" in error()
    write_run(run)
    (run / "beats.json").write_text('{"b": 1.0}')
    assert "no beat of a" in error()
    write_run(run, edit=lambda lines: [*lines[:-1], lines[-1][:40]])
    assert "line 302: " in error() and "the header has 19" in error()
    write_run(
        run, edit=lambda lines: [*lines[:5], lines[5].rpartition(",")[0] + ",nan", *lines[6:]]
    )
    assert "line 6, column y8_m: given nan" in error()
    write_run(run, frames=40)
    assert "40 frames" in error()
    write_run(run, beat=0.1)
    assert "one beat (10.00 s)" in error()
