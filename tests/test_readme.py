"""The examples of the README and of the how-to guides work as shown."""

import json
import re
import shlex
import tomllib

import jax
import numpy as np
import pytest

from slider_jax.cli.main import COMMANDS, main
from slider_jax.effects.library import load_effects
from slider_jax.experiment import load as experiment
from slider_jax.sweep import sweep
from tests.support.data import ROOT
from tests.support.own_effects import restored_library


def blocks(document, language):
    """Contents of a document's fenced code blocks of one language."""
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / document).read_text(), re.DOTALL)


def command(document, name):
    """A document's example of a slider command, as arguments."""
    lines = [line for block in blocks(document, "sh") for line in block.splitlines()]
    found = [shlex.split(line)[1:] for line in lines if line.startswith(f"slider {name} ")]
    assert len(found) == 1, f"{len(found)} examples of slider {name}"
    return found[0]


@pytest.fixture
def in_copy(tmp_path, monkeypatch):
    """A folder with the files that the commands name; the experiment has a coarser mesh."""
    (tmp_path / "docs").mkdir()
    text = (ROOT / "docs" / "experiment.toml").read_text()
    for fine, coarse in (("nodes = 51", "nodes = 11"), ("step = 0.001", "step = 0.005")):
        assert fine in text
        text = text.replace(fine, coarse)
    (tmp_path / "docs" / "experiment.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SLIDER_CACHE", "off")
    return tmp_path


def test_the_readme_is_one_page_that_starts_with_two_commands():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 150
    demo, tests, *_ = blocks("README.md", "sh")
    assert demo.splitlines() == [
        "python3 -m venv .venv && .venv/bin/pip install -q -r requirements.lock -e . && "
        ".venv/bin/slider demo"
    ]
    (ci,) = re.findall(r"^pytest .*$", (ROOT / ".ci" / "run").read_text(), re.MULTILINE)
    assert tests.strip().endswith(f"&& .venv/bin/{ci}")


def test_the_library_example_prints_the_documented_text(capsys):
    page = "docs/how-to/using_the_library.md"
    (code,) = blocks(page, "python")
    exec(compile(code, page, "exec"), {})
    (text,) = re.findall(r"prints `(.*?)`", (ROOT / page).read_text())
    assert capsys.readouterr().out.strip() == text


def test_simulate_example(in_copy):
    assert main(command("README.md", "simulate")) in (None, 0)
    out = in_copy / "results" / "example"
    for name in ("still.csv", "towed.csv", "summary.json", "still.png", "towed_midlines.png"):
        assert (out / name).stat().st_size > 0
    trials = json.loads((out / "summary.json").read_text())["trials"]
    assert [trial["periodic"] for trial in trials] == [True, True]


def test_sweep_example_with_fewer_points(in_copy, monkeypatch):
    monkeypatch.setattr(sweep, "available_cores", lambda: 1)  # so one chunk of two
    quick = ["--strides", "2", "--transient", "1", "--steps-per-stride", "40"]
    args = command("docs/how-to/simulating.md", "sweep")
    args[args.index("--count") + 1] = "2"
    assert main([*args, *quick]) in (None, 0)
    for name in ("sweep.csv", "sweep.json", "sweep.png"):
        assert (in_copy / "results" / "tail" / name).stat().st_size > 0


def test_a_guide_names_every_command():
    guides = [ROOT / "README.md", *(ROOT / "docs").glob("[he]*/*.md")]
    text = "\n".join(path.read_text() for path in guides)
    missing = [name for name in COMMANDS if not re.search(rf"slider {name}\b", text)]
    assert not missing


def test_linked_files_exist():
    for document in [*ROOT.glob("*.md"), ROOT / "rig" / "firmware" / "README.md"]:
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", document.read_text()):
            assert (document.parent / target).exists(), f"{document.name}: {target}"


def test_the_skeleton_of_an_effect_passes_the_check(tmp_path):
    path = tmp_path / "axial_drag.py"
    path.write_text(blocks("docs/how-to/adding_an_effect.md", "python")[0])
    with restored_library():
        assert load_effects(path) == ["axial_drag"]


def test_the_skeleton_of_an_effect_runs_and_brakes_by_its_closed_form():
    skeleton, use = blocks("docs/how-to/adding_an_effect.md", "python")[:2]
    names = {}
    exec(compile(skeleton, "skeleton", "exec"), names)
    exec(compile(use, "use", "exec"), names)
    assert names["run"].ok
    # Along a nearly straight body in a stream U the friction is close to rho C_t H L U^2/2.
    loss = float(names["null"] - names["value"])
    assert loss == pytest.approx(0.5 * 1000.0 * 0.02 * 0.03 * 0.368 * 0.3**2, rel=0.05)


def test_every_default_that_the_example_experiment_names_is_the_default():
    """A key with "(default)" beside it can be left out and nothing changes."""
    path = ROOT / "docs" / "experiment.toml"
    text = path.read_text()
    shorter = "\n".join(line for line in text.splitlines() if "(default)" not in line)
    assert shorter.count("\n") < text.count("\n") - 8
    full = experiment.load(path)
    short = experiment.assemble(tomllib.loads(shorter), "shorter", path.parent)
    assert full.model_dump() == short.model_dump()
    models = (experiment.to_model(x, 0) for x in (full, short))
    jax.tree.map(np.testing.assert_array_equal, *models)
