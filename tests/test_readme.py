"""What the README and the guide to effects show works as shown."""

import json
import re
import shlex
import tomllib

import jax
import pytest

from slider_jax.cli.main import COMMANDS, main
from slider_jax.experiment import load as experiment
from slider_jax.sweep import sweep
from tests.support.data import ROOT


def blocks(document, language):
    """Contents of a document's fenced code blocks of one language."""
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / document).read_text(), re.DOTALL)


def command(name):
    """The README's example of a slider command, as arguments."""
    lines = [line for block in blocks("README.md", "sh") for line in block.splitlines()]
    found = [shlex.split(line)[1:] for line in lines if line.startswith(f"slider {name} ")]
    assert len(found) == 1, f"{len(found)} examples of slider {name}"
    return found[0]


@pytest.fixture
def in_copy(tmp_path, monkeypatch):
    """A folder that holds what the README's commands name, the example on a coarser mesh."""
    (tmp_path / "docs").mkdir()
    text = (ROOT / "docs" / "experiment.toml").read_text()
    for fine, coarse in (("nodes = 51", "nodes = 11"), ("step = 0.001", "step = 0.005")):
        assert fine in text
        text = text.replace(fine, coarse)
    (tmp_path / "docs" / "experiment.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SLIDER_CACHE", "off")
    return tmp_path


def test_the_library_example_prints_what_the_readme_says(capsys):
    (code,) = blocks("README.md", "python")
    exec(compile(code, "README.md", "exec"), {})
    (said,) = re.findall(r"prints `(.*?)`", (ROOT / "README.md").read_text())
    assert capsys.readouterr().out.strip() == said


def test_simulate_example(in_copy):
    assert main(command("simulate")) in (None, 0)
    out = in_copy / "results" / "example"
    for name in ("still.csv", "towed.csv", "summary.json", "still.png", "towed_midlines.png"):
        assert (out / name).stat().st_size > 0
    trials = json.loads((out / "summary.json").read_text())["trials"]
    assert [trial["periodic"] for trial in trials] == [True, True]


def test_sweep_example_on_fewer_members(in_copy, monkeypatch):
    monkeypatch.setattr(sweep, "available_cores", lambda: 1)  # so one chunk of two
    quick = ["--strides", "2", "--transient", "1", "--steps-per-stride", "40"]
    args = command("sweep")
    args[args.index("--count") + 1] = "2"
    assert main([*args, *quick]) in (None, 0)
    for name in ("sweep.csv", "sweep.json", "sweep.png"):
        assert (in_copy / "results" / "tail" / name).stat().st_size > 0


def test_every_command_has_an_example():
    text = "\n".join(blocks("README.md", "sh"))
    assert all(re.search(rf"slider {name}\b", text) for name in COMMANDS)


def test_linked_files_exist():
    for document in [*ROOT.glob("*.md"), ROOT / "rig" / "firmware" / "README.md"]:
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", document.read_text()):
            assert (document.parent / target).exists(), f"{document.name}: {target}"


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
    assert jax.tree.leaves(experiment.to_model(full, 0)) == jax.tree.leaves(
        experiment.to_model(short, 0)
    )
