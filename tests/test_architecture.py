"""Data flows one way: the imports of every module, read from its source."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

LAYERS = [
    {"errors", "files", "precision", "provenance"},
    {"grid"},
    {"parameters"},
    {"state"},
    {"frame"},
    {"beam"},
    {"effects", "supports", "actuation", "linear"},
    {"residual", "model"},
    {"newton", "pneumatics"},
    {"scheme"},
    {"step"},
    {"rollout"},
    {"observables"},
    # Whatever is not named is a product of the simulator: no layer above may lean on it.
    {"products"},
    {"cli"},
]
RANK = {room: rank for rank, layer in enumerate(LAYERS) for room in layer}


def modules(package):
    """{dotted name: source file} of a top-level package."""
    files = sorted((ROOT / package).rglob("*.py"))
    return {".".join(f.relative_to(ROOT).with_suffix("").parts): f for f in files}


def imports(path, name):
    """Dotted names that a module imports anywhere in it, also inside functions."""
    package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    if path.name == "__init__.py":
        package = package[:-1]
    found = set()
    for node in ast.walk(ast.parse(path.read_text(), str(path))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            found |= {module} | {f"{module}.{alias.name}" for alias in node.names}
    return found


def room(name):
    """`slider_jax.effects.water.drag` lives in `effects`; rooms that are not named are products."""
    parts = name.split(".")
    if len(parts) < 2 or parts[1] == "__init__":
        return None
    return parts[1] if parts[1] in RANK else "products"


def upward_imports(source_of):
    """(importer, imported) of every import within slider_jax that goes against the flow."""
    wrong = []
    for name, path in source_of.items():
        mine = room(name)
        if mine is None:
            continue
        for other in imports(path, name):
            theirs = room(other) if other.startswith("slider_jax.") else None
            if theirs and RANK[theirs] > RANK[mine]:
                wrong.append((name, other))
    return wrong


def test_no_module_imports_from_a_layer_above():
    source_of = modules("slider_jax")
    assert len(source_of) > 20
    assert upward_imports(source_of) == []


def test_an_upward_import_is_found(tmp_path):
    """The check itself: it sees plain, from, relative and nested imports."""
    bad = tmp_path / "beam.py"
    for line in (
        "import slider_jax.dynamics.rollout",
        "from slider_jax import rollout",
        "from slider_jax.dynamics.step import Carry",
        "from .rollout import rollout",
        "def f():\n    from slider_jax.sweep.sweep import run",
    ):
        bad.write_text(line + "\n")
        assert upward_imports({"slider_jax.beam.equations": bad}), line
    bad.write_text("from slider_jax.beam.grid import Grid\n")
    assert upward_imports({"slider_jax.beam.equations": bad}) == []


def test_no_two_modules_import_each_other_in_a_ring():
    source_of = {
        name.removesuffix(".__init__"): path
        for package in ("slider_jax", "calibration", "rig")
        for name, path in modules(package).items()
    }
    ties = {
        name: {other for other in imports(path, name) if other in source_of and other != name}
        for name, path in source_of.items()
        if path.name != "__init__.py"
    }
    state = {}

    def visit(name, trail):
        if state.get(name) == "done" or name not in ties:
            return
        assert state.get(name) != "open", f"ring: {' -> '.join([*trail, name])}"
        state[name] = "open"
        for other in ties[name]:
            visit(other, [*trail, name])
        state[name] = "done"

    for name in ties:
        visit(name, [])


@pytest.mark.parametrize(
    ("package", "forbidden"),
    [
        ("rig", {"jax", "jaxlib", "equinox", "slider_jax", "calibration"}),
        ("slider_jax", {"calibration", "rig"}),
        ("calibration", {"rig"}),
    ],
)
def test_packages_keep_apart(package, forbidden):
    for name, path in modules(package).items():
        if name.startswith("slider_jax.cli"):
            continue
        roots = {other.split(".")[0] for other in imports(path, name)}
        assert not roots & forbidden, f"{name} imports {roots & forbidden}"


def test_nothing_imports_the_command_line():
    for package in ("slider_jax", "calibration", "rig"):
        for name, path in modules(package).items():
            if not name.startswith("slider_jax.cli"):
                found = [f"{i}." for i in imports(path, name)]
                assert not any(i.startswith("slider_jax.cli.") for i in found), name


def test_importing_the_library_changes_no_setting_of_jax():
    names = [
        name.removesuffix(".__init__")
        for name in modules("slider_jax")
        if not name.startswith("slider_jax.cli")
    ]
    code = f"""
import importlib, jax
before = dict(jax.config.values)
for name in {names!r}:
    importlib.import_module(name)
changed = {{k for k, v in jax.config.values.items() if k in before and before[k] != v}}
assert not changed, changed
assert not jax.config.jax_enable_x64
"""
    clean = {
        "PATH": "/usr/bin:/bin",
        "PYTHONPATH": str(ROOT),
        "MPLBACKEND": "Agg",
        "HOME": str(ROOT),
    }
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=clean)
    assert done.returncode == 0, done.stderr
