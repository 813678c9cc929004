"""An effect is one file and nothing else, in the package or in a folder of the user's own."""

import re
from pathlib import Path

import numpy as np
import pytest

from slider_jax import effects
from slider_jax.effects.library import LIBRARY, LOADED_FILES, load_effects
from slider_jax.errors import InputError
from slider_jax.experiment.load import assemble
from slider_jax.simulation.effect_signature import built_in_experiment
from slider_jax.simulation.trial import simulate_trial
from tests.support.data import ROOT

FILE = '''"""Friction along the body."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import ForceDensity, parameter, shape_parameter


class WallFriction(ForceDensity):
    """F_tau = -c u_tau. Source: this test."""

    title = "friction at a wall"

    c: Scalar = parameter(0.0, 0.0, 10.0, "N s/m^2", "the range of this test")
    width: Scalar = shape_parameter(0.1, 0.01, 1.0, "m/s", "the range of this test")

    def force(self, x):
        return -self.c * x.u_tau, jnp.zeros_like(x.u_n)
'''


@pytest.fixture(autouse=True)
def library():
    """Restores the library after each test."""
    before, files = dict(LIBRARY), list(LOADED_FILES)
    yield before
    LIBRARY.clear()
    LIBRARY.update(before)
    LOADED_FILES[:] = files


def simulated_thrust(c):
    """Thrust (n,) [N] of the built-in robot, towed on a coarse mesh, with the effect of `FILE`."""
    content = built_in_experiment().model_dump()
    content["numerics"] |= {"nodes": 11, "step": 5e-3}
    content["trials"] = [content["trials"][0] | {"duration": 0.1, "tow_speed": 0.2}]
    content["effects"] = [{"name": "wall_friction", "c": c}]
    return simulate_trial(assemble(content, "test", Path()), declared_drive=True).series["thrust"]


def test_an_effect_of_one_file_outside_the_package_acts_in_an_experiment(tmp_path):
    with pytest.raises(InputError, match="effects.0.name: given 'wall_friction'; allowed"):
        simulated_thrust(1.0)
    (tmp_path / "wall.py").write_text(FILE)
    assert load_effects(tmp_path / "wall.py") == ["wall_friction"]
    assert list(LIBRARY)[-1] == "wall_friction"
    assert LOADED_FILES[-1] == (tmp_path / "wall.py").resolve()
    without, with_friction = simulated_thrust(0.0), simulated_thrust(5.0)
    assert np.isfinite(with_friction).all()
    assert with_friction.mean() < without.mean()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("def force(self, x):", "def force(self, x)", "line 17: invalid Python: expected ':'"),
        ("import jax.numpy", "import no_such_module", "cannot be imported: ModuleNotFoundError"),
        ("def force(", "def push(", "defines no effect"),
        ('title = "friction at a wall"', "", "WallFriction: has no title"),
        ("= parameter(0.0, 0.0, 10.0, ", "= parameter(", "missing 3 required positional arguments"),
        (
            "_parameter(0.1,",
            "_parameter(2.0,",
            "WallFriction.width: given default 2, prior 0.01 to",
        ),
        ('parameter(0.0, 0.0, 10.0, "N s/m^2", "the range of this test")', "0.0", "no parameter"),
        ("parameter(0.0,", "parameter(-1.0,", "WallFriction.c: given null -1, prior 0 to 10"),
        ("class WallFriction", "class HeadDrag", "HeadDrag: the effect 'head_drag' exists"),
    ],
)
def test_a_file_that_is_wrong_gets_one_error_and_adds_nothing(tmp_path, library, old, new, message):
    assert FILE.count(old) >= 1
    path = tmp_path / "wall.py"
    path.write_text(FILE.replace(old, new, 1))
    with pytest.raises(InputError, match=f"{re.escape(str(path))}: .*{re.escape(message)}"):
        load_effects(path)
    assert library == LIBRARY


def test_a_missing_file_and_a_file_of_another_kind_are_refused(tmp_path):
    with pytest.raises(InputError, match="cannot be read: No such file"):
        load_effects(tmp_path / "missing.py")
    with pytest.raises(InputError, match="is not a Python file"):
        load_effects(tmp_path / "effects.toml")


def test_the_library_holds_one_effect_for_each_file_of_a_place():
    """Discovery misses no file."""
    folder = Path(effects.__file__).parent
    files = {path.stem for path in folder.glob("*/*.py")} - {"__init__"}
    assert files - set(LIBRARY) == {"drag", "reactive"}  # parts of every model
    assert set(LIBRARY) <= files


def test_no_module_outside_names_an_effect_to_state_a_fact_about_it():
    """The base class states facts about effects; see `Effect`."""
    names = "|".join(kind.__name__ for kind in LIBRARY.values())
    dispatch = re.compile(rf"is(?:instance|subclass)\(.*\b(?:{names})\b(?!\.)")
    folders = (ROOT / package for package in ("slider_jax", "calibration", "rig"))
    sources = {path: path.read_text() for folder in folders for path in folder.rglob("*.py")}
    found = {path.name: len(dispatch.findall(text)) for path, text in sources.items()}
    # The paper's table searches for the area of head drag; climbing puts weight of its own.
    assert {name: n for name, n in found.items() if n} == {"table_sensitivity.py": 2, "gait.py": 1}
