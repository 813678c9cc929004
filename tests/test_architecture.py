"""Data flows one way: the imports of every module, read from its source."""

import ast
import subprocess
import sys
from collections import Counter, defaultdict

import pytest

from tests.support.data import ROOT

PACKAGES = ("slider_jax", "calibration", "rig")

LAYERS = [
    {"slider_jax.errors", "slider_jax.precision"},
    {"slider_jax.beam"},
    {"slider_jax.io", "slider_jax.actuation", "slider_jax.supports", "slider_jax.water"},
    {"slider_jax.effects", "slider_jax.rod"},
    {"slider_jax.dynamics"},
    {"slider_jax.programs", "slider_jax.spatial"},
    {"slider_jax.observables", "slider_jax.paper"},
    {"slider_jax.channels"},
    {"slider_jax.experiment"},
    {"slider_jax.simulation", "slider_jax.statics"},
    {"slider_jax.batch", "slider_jax.realtime"},
    {"slider_jax.swimming"},
    {"slider_jax.climbing", "slider_jax.sweep"},
    {"slider_jax.transition"},
    {"slider_jax.optimise", "slider_jax.reproduction"},
    {"slider_jax.statements"},
    {"calibration.model"},
    {"calibration.measurements"},
    {"calibration.audit", "calibration.inference"},
    {"calibration.bench", "calibration.reporting", "calibration.twin"},
    {"calibration.discrepancy", "calibration.lamprey", "calibration.robot_fish"},
    {
        "calibration.experiment_design",
        "calibration.free_swimming",
        "calibration.pressure_logs",
        "calibration.tentacle",
    },
    {"calibration.identification", "calibration.learning"},
    {"rig.chambers", "rig.errors", "rig.files", "rig.scheduling", "rig.protocol"},
    {"rig.recording"},
    {"rig.camera", "rig.force", "rig.manifold"},
    {"rig.gantry", "rig.simulated", "rig.trial"},
    {"slider_jax.cli"},
    {"rig.cli"},
    {"calibration.cli"},
]
"""Rooms from the lowest to the highest; a room imports from rooms of lower layers only."""
RANK = {room: rank for rank, layer in enumerate(LAYERS) for room in layer}


def modules(package):
    """{dotted name: source file} of a top-level package."""
    files = sorted((ROOT / package).rglob("*.py"))
    return {".".join(f.relative_to(ROOT).with_suffix("").parts): f for f in files}


def every_module():
    return {name: path for package in PACKAGES for name, path in modules(package).items()}


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
    """`slider_jax.effects.water.drag` is in the room `slider_jax.effects`; a package is in none."""
    parts = name.removesuffix(".__init__").split(".")
    if parts[0] not in PACKAGES or len(parts) < 2:
        return None
    return ".".join(parts[:2])


def upward_imports(source_of):
    """(importer, imported) of every import between rooms that goes against the flow."""
    wrong = []
    for name, path in source_of.items():
        mine = room(name)
        if mine is None:
            continue
        for other in imports(path, name):
            theirs = room(other)
            if theirs in RANK and theirs != mine and RANK[theirs] >= RANK[mine]:
                wrong.append((name, other))
    return wrong


def test_every_room_is_ranked_and_every_rank_is_a_room():
    rooms = {room(name) for name in every_module()} - {None}
    assert rooms == set(RANK)


def test_no_module_imports_from_its_own_layer_or_one_above():
    source_of = every_module()
    assert len(source_of) > 300
    assert upward_imports(source_of) == []


def test_an_upward_import_is_found(tmp_path):
    """The check itself: it sees plain, from, relative and nested imports."""
    bad = tmp_path / "equations.py"
    name = "slider_jax.beam.equations"
    for line in (
        "import slider_jax.dynamics.rollout",
        "from slider_jax import dynamics",
        "from slider_jax.dynamics.step import Carry",
        "from ..dynamics.rollout import rollout",
        "def f():\n    from slider_jax.sweep.sweep import run",
        "from slider_jax.actuation import SquareWave",
    ):
        bad.write_text(line + "\n")
        assert upward_imports({name: bad}), line
    bad.write_text(
        "from slider_jax.beam.grid import Grid\nfrom slider_jax.errors import InputError\n"
    )
    assert upward_imports({name: bad}) == []


def test_every_room_says_what_it_knows_and_is_on_the_architecture_page():
    page = (ROOT / "docs" / "explanation" / "architecture.md").read_text()
    for name in RANK:
        path = ROOT / name.replace(".", "/")
        source = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
        assert ast.get_docstring(ast.parse(source.read_text())), name
        assert f"| `{name.split('.')[1]}` |" in page, name


def test_no_test_imports_from_another_test_and_tests_mirror_the_rooms():
    rooms = {tuple(name.split(".")[:2]) for name in RANK}
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        place = path.relative_to(ROOT / "tests").parts[:-1]
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        others = {x for x in imports(path, name) if x.startswith("tests.")}
        assert all(x.startswith("tests.support") for x in others), f"{name} imports {others}"
        assert place[:2] in rooms or len(place) < 2 or place == ("rig", "firmware"), name


@pytest.mark.parametrize("kind", [ast.ClassDef, ast.FunctionDef])
def test_a_public_name_is_defined_once(kind):
    homes = defaultdict(list)
    for name, path in every_module().items():
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, kind) and not node.name.startswith("_"):
                homes[node.name].append(name)
    assert {name: where for name, where in homes.items() if len(where) > 1} == {}


def test_a_room_holds_a_dozen_modules_at_most_and_the_top_of_a_package_six():
    count = Counter(
        str(path.parent.relative_to(ROOT))
        for path in every_module().values()
        if path.name != "__init__.py" and "effects" not in path.parts
    )
    most = {folder: 6 if folder in PACKAGES else 12 for folder in count}
    assert {folder: n for folder, n in count.items() if n > most[folder]} == {}


def test_no_two_modules_import_each_other_in_a_ring():
    source_of = {
        name.removesuffix(".__init__"): path
        for package in PACKAGES
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
    """Only commands may import from another package than those that theirs is built on."""
    for name, path in modules(package).items():
        if room(name) in ("rig.cli", "calibration.cli"):
            continue
        roots = {other.split(".")[0] for other in imports(path, name)}
        assert not roots & forbidden, f"{name} imports {roots & forbidden}"


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


def test_a_simulation_imports_only_what_it_needs():
    """The other modules would add a second to the start of every command."""
    unneeded = [
        "evosax", "matplotlib", "optax", "pandas", "scipy",
        "slider_jax.effects.dictionary.details", "calibration", "rig",
    ]  # fmt: skip
    code = (
        "import sys; from slider_jax.cli.main import prepare_jax; prepare_jax(); "
        "import slider_jax.simulation.trial, slider_jax.swimming.free_swim, "
        "slider_jax.climbing.climb, slider_jax.reproduction.frequency_sweep, slider_jax.programs; "
        f"print(*(x for x in {unneeded} if x in sys.modules))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert run.stderr == "" and run.stdout.split() == []


def test_help_imports_neither_jax_nor_numpy():
    code = "import sys; from slider_jax.cli.main import main; main(['--help']); "
    code += "print('imported', *(x for x in ('jax', 'numpy', 'tyro') if x in sys.modules))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert run.stdout.endswith("imported\n") and run.stderr == ""
