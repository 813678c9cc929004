"""The compiled twin of the structured solver: a C++ library that XLA calls.

The library is compiled at its first use, with the C++ compiler of the machine and the header files
of the installed jaxlib, and kept in the cache folder. If this is not possible, `why_unavailable`
says why, and `block_solver` uses its functions in JAX.
"""

import ctypes
import functools
import hashlib
import logging
import os
import shlex
import shutil
import subprocess
import tempfile
from contextlib import suppress
from pathlib import Path

import jax
import jaxlib
from jaxtyping import Array, Float

from slider_jax.io.files import cache_folder, processor_features, replacing

SOURCE = Path(__file__).with_name("block_kernel.cc")
FLAGS = ("-O3", "-march=native", "-std=c++17", "-shared", "-fPIC", "-w")
PADDING = 8
"""The number of cells in the factors is a multiple of this number, as in the source."""
TARGETS = ("factorise", "solve", "correct", "solve_transposed")


def _compiler() -> list[str] | None:
    """Returns the command of the C++ compiler, or None."""
    given = os.environ.get("CXX")
    if given:
        return shlex.split(given)
    found = next((x for x in ("c++", "g++", "clang++") if shutil.which(x)), None)
    return None if found is None else [found]


@functools.cache
def library_digest() -> str:
    """Returns a digest of what the compiled library depends on."""
    parts = (
        SOURCE.read_text(),
        *FLAGS,
        jaxlib.__version__,
        processor_features(),
        *(_compiler() or ()),
    )
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:12]


def _build(path: Path, compiler: list[str]) -> None:
    """Compiles the library to `path`; raises `OSError` or `CalledProcessError`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as new:
        command = [*compiler, *FLAGS, f"-I{jax.ffi.include_dir()}", str(SOURCE), "-o", str(new)]
        subprocess.run(command, check=True, capture_output=True, text=True)


@functools.cache
def why_unavailable() -> str | None:
    """Returns why the library cannot be used, or None.

    The first call compiles and loads the library. If this fails, it writes one line to the log.
    """
    library = _load()
    if isinstance(library, str):
        logging.getLogger(__name__).warning(
            "simulations take about twice as long, because the compiled solver is missing: %s",
            library,
        )
        return library
    for name in TARGETS:
        handler = jax.ffi.pycapsule(getattr(library, f"slider_{name}"))
        jax.ffi.register_ffi_target(_target(name), handler, platform="cpu")
    return None


def is_used() -> bool:
    """Returns whether solvers use the library: on a CPU, if it is available."""
    return jax.default_backend() == "cpu" and why_unavailable() is None


def _load() -> ctypes.CDLL | str:
    """Returns the library, or why it cannot be loaded."""
    try:
        compiler = _compiler()
        try:
            library = _library(cache_folder(), compiler)
        except (OSError, RuntimeError):  # not writable, or there is no home
            with tempfile.TemporaryDirectory() as folder:
                library = _library(Path(folder), compiler)
        return library or "no C++ compiler was found; install g++ or clang++, or set CXX"
    except subprocess.CalledProcessError as error:
        lines = [x for x in error.stderr.splitlines() if "error" in x] or error.stderr.splitlines()
        first = lines[0] if lines else f"exit status {error.returncode}"
        return f"the C++ compiler {error.cmd[0]} failed: {first}"
    except (OSError, ValueError) as error:
        return f"{error}; check CXX={os.environ.get('CXX', '')} and XDG_CACHE_HOME"


def _library(folder: Path, compiler: list[str] | None) -> ctypes.CDLL | None:
    """Returns the library of a folder; compiles it if it is missing or damaged."""
    path = folder / f"block_kernel-{library_digest()}.so"
    if path.exists():
        with suppress(OSError):
            return ctypes.CDLL(str(path))
    if compiler is None:
        return None
    _build(path, compiler)
    return ctypes.CDLL(str(path))


def _target(name: str) -> str:
    """Returns the name of a function. It contains the digest, because JAX stores programs."""
    return f"slider_{name}_{library_digest()}"


def _call(name: str, *shapes, in_place: dict[int, int] | None = None):
    """Returns the function `name`; `in_place` maps inputs to the outputs that may replace them."""
    return jax.ffi.ffi_call(
        _target(name), shapes, vmap_method="expand_dims", input_output_aliases=in_place
    )


def factorise(
    left: Float[Array, "2k 2k cells"],
    right: Float[Array, "2k 2k cells"],
    tail: Float[Array, "k 2k"],
    head: Float[Array, "k 2k"],
) -> Float[Array, " size"]:
    """Returns the factors of a `BeamOperator` without `update`."""
    k, cells = len(tail), left.shape[-1]
    padded = -(-cells // PADDING) * PADDING
    size = 4 * k * k * (2 * padded + 1)
    return _call("factorise", jax.ShapeDtypeStruct((size,), left.dtype))(left, right, tail, head)[0]


def solve(factors: Float[Array, " size"], rhs) -> Float[Array, "2k nodes"]:
    """Returns the solution for a right side (cells, tail, head)."""
    rows, cells = rhs[0].shape
    shape = jax.ShapeDtypeStruct((rows, cells + 1), factors.dtype)
    return _call("solve", shape)(factors, *rhs)[0]


def correct(
    factors: Float[Array, " size"],
    rhs,
    scale: Float[Array, "2k 1"],
    y: Float[Array, "2k nodes"],
    sizes: Float[Array, "2"],
) -> tuple[Float[Array, "2k nodes"], Float[Array, "2"]]:
    """Returns y minus the solution for `rhs`, and the sizes of the last two changes.

    The size of a change is the largest value of |change| / max(scale, |y|). The results replace `y`
    and `sizes` in memory. Under `vmap`, these two must therefore be batched, as they are in a loop.
    """
    shapes = (jax.ShapeDtypeStruct(x.shape, x.dtype) for x in (y, sizes))
    better, last = _call("correct", *shapes, in_place={5: 0, 6: 1})(factors, *rhs, scale, y, sizes)
    return better, last


def solve_transposed(factors: Float[Array, " size"], y: Float[Array, "2k nodes"]):
    """Returns (cells, tail, head), the solution of the transposed system for `y`."""
    rows, nodes = y.shape
    shapes = ((rows, nodes - 1), (rows // 2,), (rows // 2,))
    structs = (jax.ShapeDtypeStruct(shape, factors.dtype) for shape in shapes)
    return tuple(_call("solve_transposed", *structs)(factors, y))
