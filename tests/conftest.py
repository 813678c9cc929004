"""Settings of the test run, made before JAX is imported, and the fixtures that all tests share."""

import fcntl
import gc
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from importlib.metadata import version
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Most of a test is compilation. Without the fusion emitters, programs compile in half the time and
# run a sixth longer. Without the hoisting of loop invariants, the largest programs compile in 0.8
# of the time. A release that does not know a flag would stop at it.
QUICK = ""
if version("jaxlib").startswith("0.10."):
    QUICK = " --xla_cpu_use_fusion_emitters=false"
    QUICK += " --xla_disable_hlo_passes=while-loop-invariant-code-motion"
os.environ.setdefault("XLA_FLAGS", f"--xla_cpu_multi_thread_eigen=false{QUICK}")
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(ROOT / ".pytest_cache" / "jax"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")

# Tracing makes millions of small objects: frequent collections cost a tenth of the suite.
gc.set_threshold(100_000, 50, 100)

STILL_TANK = ("test_detectability.py", "test_next_experiment.py")
"""Files that compile the same programs."""

import jax  # noqa: E402
import pytest  # noqa: E402

from calibration.model.compiled import limit_memory_maps  # noqa: E402
from slider_jax.precision import enable_float64  # noqa: E402
from tests.support.data import data_dir, missing_in_ci  # noqa: E402

enable_float64()
jax.config.update("jax_numpy_dtype_promotion", "strict")


def pytest_sessionstart() -> None:
    """Stops a CI run at once that would skip the tests on measured data."""
    if problem := missing_in_ci():
        raise pytest.UsageError(problem)


def _waits(item: pytest.Item) -> bool:
    """Whether the test mostly waits, as those of the rig do, which run in real time."""
    return item.nodeid.startswith("tests/rig/")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Spreads the files whose tests wait evenly between the files whose tests compute."""
    place = {}
    for waits in (False, True):
        files = list(dict.fromkeys(item.path for item in items if _waits(item) == waits))
        place |= {file: (i + 0.5) / len(files) for i, file in enumerate(files)}
    items.sort(key=lambda item: place[item.path])


def pytest_xdist_make_scheduler(config: pytest.Config, log):
    """Gives each file to one process, and files that compile the same programs to the same one."""
    from xdist.scheduler import LoadFileScheduling

    class Scheduler(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = super()._split_scope(nodeid)
            return "still_tank" if Path(file).name in STILL_TANK else file

    return Scheduler(config, log)


@contextmanager
def a_core() -> Iterator[None]:
    """Waits until fewer tests compute than the machine has cores."""
    folder = ROOT / ".pytest_cache"
    folder.mkdir(exist_ok=True)
    files = [(folder / f"core_{i}").open("w") for i in range(os.cpu_count() or 1)]
    try:
        while not any(_locked(file) for file in files):
            time.sleep(1e-3)
        yield
    finally:
        for file in files:
            file.close()


def _locked(file) -> bool:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item):
    """Lets a process without a core run only tests that wait.

    Three processes that compile on two cores need a third more processor time than two.
    """
    if _waits(item):
        return (yield)
    with a_core():
        return (yield)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Compiles in two thirds of the time, unless a test runs its programs for long."""
    long = any(item.get_closest_marker(name) for name in ("slow", "optimised"))
    jax.config.update("jax_disable_most_optimizations", not long)


@pytest.fixture(autouse=True, scope="module")
def few_memory_maps():
    """Drops compiled programs between files, because most of the suite runs in one process."""
    yield
    limit_memory_maps()


@pytest.fixture(autouse=True)
def no_kept_programs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands in this process keep no programs, because a test may have changed a function."""
    monkeypatch.setattr("slider_jax.programs.kept_programs", nullcontext)


@pytest.fixture(scope="module")
def drawn() -> dict:
    """The pictures that the tests of a file have drawn, by the lines of code that save them."""
    return {}


@pytest.fixture(autouse=True)
def no_picture_twice(request, monkeypatch: pytest.MonkeyPatch, drawn: dict) -> None:
    """Draws the first picture of a line of code; later ones of the same test file are copies of it.

    Drawing takes far longer than making the figure, which every test does. The tests that look at
    their pictures draw them all, and so do slow tests.
    """
    figure = sys.modules.get("matplotlib.figure")
    if figure is None or any(request.node.get_closest_marker(x) for x in ("slow", "draws")):
        return
    draw = figure.Figure.savefig

    def savefig(self, target, **options):
        frame, place = sys._getframe(1), []
        for _ in range(2):
            place.append((frame.f_code.co_filename, frame.f_lineno))
            frame = frame.f_back
        is_file = isinstance(target, str | Path)
        key = (*place, options.get("format") or (Path(target).suffix if is_file else ""))
        if key not in drawn:
            draw(self, target, **options)
            drawn[key] = Path(target).read_bytes() if is_file else target.getvalue()
        elif is_file:
            Path(target).write_bytes(drawn[key])
        else:
            target.write(drawn[key])

    monkeypatch.setattr(figure.Figure, "savefig", savefig)


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of measured data; the test is skipped where it is absent."""
    folder = data_dir()
    if folder is None:
        pytest.skip("the measured data are absent; set SLIDER_DATA to their folder")
    return folder
