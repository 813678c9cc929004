"""The wheel, installed into an empty environment, runs the demo without the source folder."""

import os
import shutil
import site
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

from tests.support.data import ROOT

PACKAGES = ("slider_jax", "calibration", "rig")
DEMO = """
import sys
import slider_jax.reproduction.frequency_sweep as sweep
from slider_jax.beam.parameters import Numerics
from slider_jax.cli.main import main

settings = sweep.FrequencySweepSettings(
    frequencies=(1.0, 4.8), steps_per_stride=40, strides=4, transient=2,
    numerics=Numerics(tail_cells=2, body_cells=8),
)
sweep.FrequencySweepSettings = lambda: settings
sys.exit(main(["demo", "--out", "slider_demo"]))
"""


def run(folder, *words):
    """Output of a command in `folder`, without the variables that could find the source."""
    kept = {name: x for name, x in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(
        [str(x) for x in words], cwd=folder, env=kept, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel of the packages, built from a copy so that the checkout gets no build files."""
    folder = tmp_path_factory.mktemp("wheel")
    for name in PACKAGES:
        ignored = shutil.ignore_patterns("__pycache__", "*.pyc")
        shutil.copytree(ROOT / name, folder / "source" / name, ignore=ignored)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, folder / "source")
    build = ("-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "--no-index")
    run(folder, sys.executable, *build, "-w", folder, folder / "source")
    (path,) = folder.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def python(wheel, tmp_path_factory):
    """Python of an environment with the wheel; only its dependencies are those of the tests."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, with_pip=False)
    python = folder / "bin" / "python"
    pip = ("-m", "pip", "--python", python, "install", "-q", "--no-deps", "--no-index", wheel)
    run(folder, sys.executable, *pip)
    (packages,) = folder.glob("lib/python*/site-packages")
    # Folders named in a .pth file are searched last, and their own .pth files are not read, so an
    # editable installation of the source there has no effect.
    (packages / "dependencies.pth").write_text("\n".join(site.getsitepackages()))
    return python


def test_the_wheel_holds_the_packages_and_their_data_and_nothing_else(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0].split("-")[0] for name in names} == {*PACKAGES}
    for package in PACKAGES:
        assert f"{package}/py.typed" in names
    expected = {
        path.relative_to(ROOT).as_posix()
        for package in PACKAGES
        for pattern in ("*.py", "*.html", "*.cc")
        for path in (ROOT / package).rglob(pattern)
    }
    assert expected <= set(names)


@pytest.mark.slow
def test_the_demo_runs_from_the_wheel(python, tmp_path):
    home = run(tmp_path, python, "-c", "import slider_jax; print(slider_jax.__file__)").strip()
    assert Path(home).is_relative_to(python.parent.parent)
    assert run(tmp_path, python.parent / "slider", "--version").startswith("slider ")
    assert "4.8" in run(tmp_path, python, "-c", DEMO)
    assert (tmp_path / "slider_demo" / "thrust_against_frequency.png").stat().st_size > 0
