"""Keeps compiled programs in files, so that later processes neither trace nor compile them.

JAX's own cache of compiled programs saves the compilation. JAX must still trace a program to find
it there, and tracing the programs of `slider close-loop` takes longer than loading them. The name
of a file is therefore a digest of everything that determines the program before tracing: the
function, the structure of its arguments, the source files of the packages, the effect files, the
versions of the libraries, the settings of JAX and XLA, and the processor.
"""

import hashlib
import json
import os
import pickle
import platform
import re
import shutil
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
from jax.experimental.serialize_executable import deserialize_and_load, serialize

import calibration
import slider_jax
from slider_jax.io.files import effect_files, versions, write_bytes

UNUSED_DAYS = 14.0
"""Programs of other versions of the source files are deleted after this time [days]."""
_ADDRESS = re.compile(r" at 0x[0-9a-f]+")
_folders: list[Path] = []
_hits = threading.local()


@contextmanager
def kept_programs() -> Iterator[None]:
    """Keeps compiled programs beside JAX's cache of compiled programs, if that cache is in use."""
    cache = jax.config.values["jax_compilation_cache_dir"]
    if not cache or not jax.config.values["jax_enable_compilation_cache"]:
        yield
        return
    _count_cache_hits()
    parent = Path(cache) / "programs"
    folder = parent / source_digest()[:16]
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        for other in parent.iterdir():
            if time.time() - other.stat().st_mtime > 86400.0 * UNUSED_DAYS:
                shutil.rmtree(other, ignore_errors=True)
    _folders.append(folder)
    try:
        yield
    finally:
        _folders.pop()


@lru_cache
def _count_cache_hits() -> None:
    """Counts the programs that JAX's cache gives to each thread, because XLA cannot store them."""

    def count(event: str, **_: Any) -> None:
        if event == "/jax/compilation_cache/cache_hits":
            _hits.count = _cache_hits() + 1

    jax.monitoring.register_event_listener(count)


def _cache_hits() -> int:
    return getattr(_hits, "count", 0)


def source_digest() -> str:
    """Returns the SHA-256 digest of the source files of both packages."""
    folders = [Path(str(package.__file__)).parent for package in (slider_jax, calibration)]
    digest = hashlib.sha256()
    for path in (x for folder in folders for x in sorted(folder.rglob("*.py"))):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def stored_program(function: Callable, arguments: Sequence[Any]) -> Callable | None:
    """Returns the program of `function` for arguments like `arguments`, loaded or compiled now.

    As in `equinox.filter_jit`, arrays may change in later calls, and all other arguments are fixed.
    Returns None if programs are not kept.
    """
    if not _folders:
        return None
    dynamic, static = eqx.partition(tuple(arguments), eqx.is_array)
    leaves, structure = jax.tree.flatten(dynamic)
    text = repr((function.__module__, function.__qualname__, structure, jax.tree.flatten(static)))
    key = [_ADDRESS.sub("", text), [(x.shape, str(x.dtype)) for x in leaves], *_surroundings()]
    digest = hashlib.sha256(json.dumps(key).encode()).hexdigest()
    path = _folders[-1] / digest

    found = _loaded(path, leaves)
    if found is None:
        outs: list[Any] = []

        def flat(*leaves):
            out = function(*eqx.combine(jax.tree.unflatten(structure, leaves), static))
            values, tree = jax.tree.flatten(out)
            outs[:] = [tree]
            return values

        before = _cache_hits()
        compiled = jax.jit(flat).lower(*leaves).compile()
        found = compiled, outs[0]
        if _cache_hits() == before:
            _store(path, *found)
    program, out = found

    def call(*given):
        values = program(*jax.tree.leaves(eqx.filter(given, eqx.is_array)))
        return jax.tree.unflatten(out, values)

    return call


def _loaded(path: Path, leaves: Sequence[Any]) -> tuple[Callable, Any] | None:
    """Returns a stored program and the structure of its result, or None if there is none."""
    try:
        content = path.read_bytes()
        if hashlib.sha256(content[32:]).digest() != content[:32]:
            return None
        program, example = pickle.loads(content[32:])
        inputs = jax.tree.structure((tuple(leaves), {}))
        values, out = jax.tree.flatten(example)
        loaded = deserialize_and_load(program, inputs, jax.tree.structure(values))
        loaded(*leaves)
        return loaded, out
    except Exception:  # whatever is wrong with the file, the program is compiled again
        return None


def _store(path: Path, compiled: Any, out: Any) -> None:
    # A program that cannot be stored is compiled again by the next process.
    with suppress(OSError, ValueError, NotImplementedError, pickle.PicklingError, TypeError):
        example = jax.tree.unflatten(out, range(out.num_leaves))
        content = pickle.dumps((serialize(compiled)[0], example))
        write_bytes(path, hashlib.sha256(content).digest() + content)


@lru_cache
def _surroundings() -> tuple[Any, ...]:
    """Returns what else determines a compiled program: versions, settings, and the processor."""
    processor = platform.processor() or platform.machine()
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        processor = " ".join(x for x in lines if x.startswith(("model name", "flags")))
    device = jax.devices()[0]
    settings = {
        name: str(jax.config.values[name])
        for name in ("jax_enable_x64", "jax_numpy_dtype_promotion", "jax_default_matmul_precision")
    }
    return (
        versions(), effect_files(), settings, os.environ.get("XLA_FLAGS"), device.platform,
        device.device_kind, processor,
    )  # fmt: skip
