"""Model of the robot fish, and the script from markers to speeds."""

import json
import os
import subprocess
import sys
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from calibration.robot_fish.fish import (
    CRANK,
    CRANK_X,
    CRANK_Y,
    HINGES,
    NOSE,
    CrankPull,
    Parameters,
    WakelessInertia,
    head_coefficient,
    height_at,
    read_dimensions,
    robot_of_fish,
    strip_weights,
)
from calibration.robot_fish.swim import SwimSettings
from slider_jax.dynamics.model import make_mesh
from tests.support.data import ROOT


@pytest.fixture
def fish(data):
    folder = data / "fishsim"
    if not folder.is_dir():
        pytest.skip("the robot fish is absent; set SLIDER_DATA to a folder with fishsim/")
    return folder


def test_mass_and_moment_of_inertia_are_those_of_the_readme(fish):
    """README: 1.4807 kg, centre at x = 0.1172 m, 0.0201 kg m^2. Tolerances: 0.1 %, 1 mm, 3 %."""
    numerics = SwimSettings().numerics
    for added in (0.0, 0.1):
        mesh = make_mesh(robot_of_fish(read_dimensions(fish), added), numerics).structure
        mass = np.asarray(mesh.linear_density * mesh.ds)
        x = NOSE + float(mesh.s[-1] + 0.5 * mesh.ds[-1]) - np.asarray(mesh.s)
        centre = mass @ x / mass.sum()
        own = mass @ np.asarray(mesh.ds) ** 2 / 12.0
        assert mass.sum() == pytest.approx(1.4807, rel=1e-3)
        assert centre == pytest.approx(0.1172, abs=1e-3)
        assert mass @ (x - centre) ** 2 + own == pytest.approx(0.0201 + added, rel=0.03)


def test_strips_turn_the_tail_by_the_hinge_angles(fish):
    numerics = SwimSettings().numerics
    robot = robot_of_fish(read_dimensions(fish))
    weights = strip_weights(robot, numerics)
    ds = make_mesh(robot, numerics).structure.ds
    np.testing.assert_allclose(weights @ ds, 1.0, rtol=1e-9)


def test_head_and_its_water_have_the_sway_mass(fish):
    """M (f/1 Hz)^p is the solid mass plus the integral of m_A. Tolerance: 1 % for the sum."""
    size = read_dimensions(fish)
    x = np.linspace(NOSE, HINGES[0], 2000)
    for beat, exponent in ((0.5, 1.5), (1.5, 1.5), (1.5, 2.0)):
        free = Parameters(3.0, 0.0, sway_mass=1.2, sway_exponent=exponent, pull=1.0, hinge=0.35)
        water = WakelessInertia(head_coefficient(size, free, beat), 0.3, 0.0, 1000.0)
        section = SimpleNamespace(
            s=np.ones_like(x), height=height_at(x, size), u_n=0.0 * x, omega=0.0 * x, u_n_t=1.0
        )
        F_tau, F_n = water.force(section)
        total = size.mass[0] - np.trapezoid(np.asarray(F_n), x)
        assert total == pytest.approx(1.2 * beat**exponent, rel=0.01)
        np.testing.assert_allclose(F_tau, 0.0)


def test_inertia_of_a_turning_strip_is_the_rate_of_its_impulse():
    """-d(m_A u_n n)/dt of a strip with u_n = cos(2 t) and the angle 3 t. Tolerance: 1e-6."""
    water = WakelessInertia(0.7, 0.3, 0.5, 1000.0)

    def impulse(t):
        normal = np.array([-np.sin(3.0 * t), np.cos(3.0 * t)])
        return 0.7 * 1000.0 * np.pi / 4.0 * 0.1**2 * np.cos(2.0 * t) * normal

    t, dt = 0.4, 1e-4
    section = SimpleNamespace(
        s=1.0, height=0.1, u_n=np.cos(2.0 * t), u_n_t=-2.0 * np.sin(2.0 * t), omega=3.0
    )
    F_tau, F_n = (float(F) for F in water.force(section))
    along, across = np.array([np.cos(3.0 * t), np.sin(3.0 * t)]), impulse(t) / np.cos(2.0 * t)
    found = F_tau * along + F_n * across / np.linalg.norm(across)
    expected = -(impulse(t + dt) - impulse(t - dt)) / (2.0 * dt)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_crank_pulls_by_its_stroke():
    """README: the distance from the motor to tail 0 changes by 34 mm to both sides."""
    wave = CrankPull(0.5, 0.0)
    pulled = float(wave.at(jnp.asarray(2.5))) - float(wave.at(jnp.asarray(3.5)))
    ends = [np.hypot(CRANK_X + side * CRANK, CRANK_Y) for side in (1.0, -1.0)]
    assert pulled == pytest.approx(ends[0] - ends[1], rel=1e-12)
    assert 0.5 * pulled == pytest.approx(0.034, abs=0.001)


def script(*words, **environment):
    return subprocess.run(
        [sys.executable, "scripts/robot_fish.py", *map(str, words)],
        cwd=ROOT, capture_output=True, text=True, env=os.environ | environment, check=False,
    )  # fmt: skip


def test_bad_input_gives_one_error(tmp_path):
    done = script(tmp_path / "none", "--out", tmp_path / "out")
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert "no such folder" in done.stderr and not (tmp_path / "out").exists()


@pytest.mark.slow
def test_both_drives_give_the_measured_speeds(fish, tmp_path):
    """Both known runs, which are also the runs of the fit.

    Bars: 0.010 and 0.015 m/s for the speed, and 15 % for the recoil with the kinematic drive.
    """
    done = script(fish, "--out", tmp_path / "out", SLIDER_DATA=str(fish.parent))
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "out" / "speeds.json").read_text())
    assert set(found) == {"f1_00", "f1_75"}
    for x in found.values():
        assert x["predicted_m_per_s"] == pytest.approx(x["measured_m_per_s"], abs=0.010)
        from_beat = x["predicted_from_frequency_m_per_s"]
        assert from_beat == pytest.approx(x["measured_m_per_s"], abs=0.015)
        for name in ("amplitude_0_m", "amplitude_1_m", "amplitude_2_m", "yaw_rad"):
            assert x[f"predicted_{name}"] == pytest.approx(x[f"measured_{name}"], rel=0.15)
    record = json.loads((tmp_path / "out" / "result.json").read_text())
    assert "versions" in record and len(record["parameters"]) == 6
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.count("data:image/png;base64") == 2
