"""An effect is one file and nothing else, in the package or in a folder of the user's own."""

import hashlib
import re
from pathlib import Path

import numpy as np
import pytest

from slider_jax import effects
from slider_jax.effects.library import LIBRARY, load_effects, load_installed_effects
from slider_jax.errors import InputError
from slider_jax.experiment.load import assemble
from slider_jax.io.files import LOADED_FILES
from slider_jax.simulation.effect_signature import built_in_experiment
from slider_jax.simulation.trial import simulate_trial
from tests.support.data import ROOT
from tests.support.own_effects import restored_library, write_effect


@pytest.fixture(autouse=True)
def library():
    with restored_library() as before:
        yield before


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
    path = write_effect(tmp_path / "wall.py")
    assert load_effects(path) == ["wall_friction"]
    assert list(LIBRARY)[-1] == "wall_friction"
    assert LOADED_FILES == {path.resolve(): hashlib.sha256(path.read_bytes()).hexdigest()}
    without, with_friction = simulated_thrust(0.0), simulated_thrust(5.0)
    assert np.isfinite(with_friction).all()
    assert with_friction.mean() < without.mean()


def test_the_effects_of_an_installed_package_join_the_library_once(tmp_path, monkeypatch):
    info = tmp_path / "lab_effects-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-effects\nVersion: 1.0\n")
    entry = "[slider_jax.effects]\nlab = lab_effects.wall\n"
    (info / "entry_points.txt").write_text(entry)
    package = tmp_path / "lab_effects"
    package.mkdir()
    (package / "__init__.py").write_text("")
    path = write_effect(package / "wall.py")
    monkeypatch.syspath_prepend(tmp_path)
    assert load_installed_effects() == ["wall_friction"]
    assert load_installed_effects() == []
    assert set(LOADED_FILES) == {path.resolve(), (package / "__init__.py").resolve()}

    (info / "entry_points.txt").write_text(entry.replace("lab_effects.wall", "lab_effects.door"))
    with pytest.raises(InputError, match=r"lab = lab_effects.door .*: cannot be imported: Module"):
        load_installed_effects()
    (info / "entry_points.txt").write_text(entry.replace(".wall", ".wall:WallFriction"))
    with pytest.raises(InputError, match="names no module"):
        load_installed_effects()


def test_the_library_holds_one_effect_for_each_file_of_a_place():
    """Discovery misses no file."""
    folder = Path(effects.__file__).parent
    paths = [path for path in folder.glob("*/*.py") if path.parent.name != "dictionary"]
    files = {path.stem for path in paths} - {"__init__"}
    assert files - set(LIBRARY) == {"drag", "reactive"}  # parts of every model
    assert set(LIBRARY) <= files


def test_no_module_outside_names_an_effect_to_state_a_fact_about_it():
    """The base class states facts about effects; see `Effect`."""
    names = "|".join(kind.__name__ for kind in LIBRARY.values())
    dispatch = re.compile(rf"is(?:instance|subclass)\(.*\b(?:{names})\b(?!\.)")
    folders = (ROOT / package for package in ("slider_jax", "calibration", "rig"))
    sources = {path: path.read_text() for folder in folders for path in folder.rglob("*.py")}
    found = {path.name: len(dispatch.findall(text)) for path, text in sources.items()}
    # Climbing puts weight of its own.
    assert {name: n for name, n in found.items() if n} == {"gait.py": 1}
