"""Compiles a function once for all threads, and keeps compiled programs in files.

A later process loads a kept program and neither traces nor compiles it. JAX's own cache of compiled
programs saves only the compilation: JAX must still trace a program to find it there, and tracing a
simulation takes longer than loading it. The name of a file here is a digest of the function, the
structure of its arguments, the source files of the packages, the versions of the libraries, the
settings of JAX and XLA, and the processor. Programs are not kept if effects of other files are
loaded, because these files may import further files.
"""

import ctypes
import hashlib
import json
import os
import pickle
import re
import shutil
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from threading import Lock
from typing import Any

import equinox as eqx
import jax

from slider_jax.dynamics import block_kernel
from slider_jax.io.files import (
    effect_files,
    processor_features,
    read_with_digest,
    versions,
    write_with_digest,
)

PACKAGES = ("slider_jax", "calibration")
FOLDER = "slider_jax_programs"
"""Name of the folder in the folder of JAX's cache."""
UNUSED_DAYS = 14.0
"""Programs of source files that no command used for this time [days] are deleted."""
_M_MMAP_THRESHOLD = -3
"""The option of `mallopt` in malloc.h."""
_VERSION = re.compile(r"[0-9a-f]{16}")
_FUNCTION = re.compile(r"(<function .*?) at 0x[0-9a-f]+>")
_folders: list[Path] = []
_hits = threading.local()
_complete: list[bool] = []
_anew = Lock()


@contextmanager
def kept_programs() -> Iterator[None]:
    """Keeps compiled programs beside JAX's cache of compiled programs, if that cache is in use."""
    cache_folder = jax.config.values["jax_compilation_cache_dir"]
    in_use = cache_folder and jax.config.values["jax_enable_compilation_cache"]
    if not in_use or "://" in cache_folder:
        yield
        return
    _count_cache_hits()
    parent = Path(cache_folder) / FOLDER
    folder = parent / _version()
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        for other in parent.iterdir():
            age = time.time() - other.stat().st_mtime
            if _VERSION.fullmatch(other.name) and age > 86400.0 * UNUSED_DAYS:
                shutil.rmtree(other, ignore_errors=True)
    _folders.append(folder)
    try:
        yield
    finally:
        _folders.pop()


def compiled_programs() -> set[Path]:
    """Returns the files of all compiled programs in the cache folder of JAX."""
    folder = jax.config.values["jax_compilation_cache_dir"]
    if not folder or "://" in folder:
        return set()
    return {*Path(folder).glob("*-cache"), *(Path(folder) / FOLDER).glob("*/*")}


@contextmanager
def all_programs_kept() -> Iterator[None]:
    """In a context of `kept_programs`, compiles programs again that only JAX's cache contains.

    XLA cannot store a program that it has loaded.
    """
    _complete.append(True)
    try:
        yield
    finally:
        _complete.pop()


def _compiled_anew(lowered: Any) -> Any:
    """Compiles a program without JAX's cache."""
    from jax.experimental.compilation_cache.compilation_cache import reset_cache

    with _anew:
        reset_cache()  # else JAX ignores a change of the option
        jax.config.update("jax_enable_compilation_cache", False)
        try:
            return lowered.compile()
        finally:
            jax.config.update("jax_enable_compilation_cache", True)
            reset_cache()


@cache
def _count_cache_hits() -> None:
    """From the first call on, counts the programs that each thread loads from JAX's cache.

    XLA cannot store such a program again.
    """

    def count(event: str, **_: Any) -> None:
        if event == "/jax/compilation_cache/cache_hits":
            _hits.count = _cache_hits() + 1

    jax.monitoring.register_event_listener(count)


def _cache_hits() -> int:
    return getattr(_hits, "count", 0)


def return_freed_memory() -> None:
    """Returns memory that the compiler or a long simulation freed to the operating system.

    GNU libc keeps it otherwise. With another C library, this function does nothing.
    """
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def return_large_arrays() -> None:
    """From now on, each array of at least 4 MiB returns its memory when it is freed.

    By default, GNU libc keeps the memory of freed arrays of up to 32 MiB. With another C library,
    this function does nothing.
    """
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, 2**22)


def _version() -> str:
    return source_digest()[:16]


def source_digest() -> str:
    """Returns the SHA-256 digest of the source files of the packages that simulate."""
    root = Path(__file__).parents[1]  # all packages are installed in the same folder
    digest = hashlib.sha256()
    for path in (x for name in PACKAGES for x in sorted((root / name).rglob("*"))):
        if path.suffix in (".py", ".cc"):
            digest.update(path.read_bytes())
    return digest.hexdigest()


def stored_program(function: Callable, arguments: Sequence[Any]) -> tuple[Callable, Any] | None:
    """Returns the program of `function`, loaded or compiled now, and its result for `arguments`.

    As in `equinox.filter_jit`, arrays may change in later calls, and all other arguments are fixed.
    Returns None if programs are not kept.
    """
    folders = list(_folders)  # another thread may end the context meanwhile
    if not folders or effect_files():
        return None
    dynamic, static = eqx.partition(tuple(arguments), eqx.is_array)
    leaves, structure = jax.tree.flatten(dynamic)
    text = program_text(function, arguments)
    if text is None:
        return None
    shapes = [(x.shape, str(x.dtype), getattr(x, "weak_type", False)) for x in leaves]
    # A loaded program needs the compiled solver, which `is_used` loads.
    solver = block_kernel.library_digest() if block_kernel.is_used() else ""
    key = json.dumps([text, shapes, versions(), _settings(), processor_features(), solver])
    path = folders[-1] / hashlib.sha256(key.encode()).hexdigest()
    found = _loaded(path, leaves)
    if found is None:
        outs: list[Any] = []

        def flat(*given):
            out = function(*eqx.combine(jax.tree.unflatten(structure, given), static))
            values, tree = jax.tree.flatten(out)
            outs[:] = [tree]
            return values

        before, lowered = _cache_hits(), jax.jit(flat).lower(*leaves)
        compiled = lowered.compile()
        if _cache_hits() > before and _complete:
            before, compiled = _cache_hits(), _compiled_anew(lowered)
        return_freed_memory()
        if _cache_hits() == before and _version() == folders[-1].name:
            _store(path, compiled, outs[0])
        found = compiled, outs[0], compiled(*leaves)
    program, out, first = found

    def call(*given):
        values = program(*jax.tree.leaves(eqx.filter(given, eqx.is_array)))
        return jax.tree.unflatten(out, values)

    return call, jax.tree.unflatten(out, first)


def program_text(function: Callable, arguments: Sequence[Any]) -> str | None:
    """Returns a text of `function`, of the structure of `arguments` and of their fixed values.

    Returns None if the text could be that of another program too: it contains an unnamed or nested
    function, or an object without a text of its own.
    """
    dynamic, static = eqx.partition(tuple(arguments), eqx.is_array)
    fixed = jax.tree.flatten(static)
    homes = [x.__module__ for x in fixed[0] if callable(x) and hasattr(x, "__qualname__")]
    name = f"{function.__module__}.{function.__qualname__}"
    text = _FUNCTION.sub(r"\1>", repr((name, jax.tree.structure(dynamic), fixed, homes)))
    return None if any(x in text for x in ("<locals>", "<lambda>", " at 0x")) else text


def _loaded(path: Path, leaves: Sequence[Any]) -> tuple[Callable, Any, Any] | None:
    """Returns a stored program, the structure of its result, and its result for `leaves`.

    Returns None if there is no such program.
    """
    try:
        from jax.experimental.serialize_executable import deserialize_and_load

        program, example = pickle.loads(read_with_digest(path))
        inputs = jax.tree.structure((tuple(leaves), {}))
        values, out = jax.tree.flatten(example)
        loaded = deserialize_and_load(program, inputs, jax.tree.structure(values))
        return loaded, out, loaded(*leaves)  # an incomplete program fails in its first call
    except Exception:  # whatever is wrong with the file, the program is compiled again
        return None


def _store(path: Path, compiled: Any, out: Any) -> None:
    with suppress(Exception):  # the next process compiles a program that cannot be stored
        from jax.experimental.serialize_executable import serialize

        example = jax.tree.unflatten(out, range(out.num_leaves))
        write_with_digest(path, pickle.dumps((serialize(compiled)[0], example)))


def _settings() -> list[Any]:
    """Returns the settings of JAX and XLA that can change a program."""
    paths = ("cache", "dir", "dump", "log")
    own = {k: str(x) for k, x in jax.config.values.items() if not any(p in k for p in paths)}
    return [own, os.environ.get("XLA_FLAGS"), [str(x) for x in jax.devices()]]


def compiled_once(function):
    """Returns the compiled `function`; a thread waits while another thread compiles it.

    JAX compiles a program twice if two threads call it for the first time at the same time. Within
    `kept_programs`, the program is loaded from a file if an earlier process stored it.
    """
    jitted = eqx.filter_jit(function)
    locks: dict[Hashable, Lock] = defaultdict(Lock)
    ready: dict[Hashable, Callable] = {}

    def call(*arguments):
        if any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves(arguments)):
            return jitted(*arguments)  # within another program
        key = call_signature(arguments)
        if key in ready:
            return ready[key](*arguments)
        with locks[key]:
            if key in ready:
                return ready[key](*arguments)
            kept = stored_program(function, arguments)
            if kept is None:
                kept = jitted, jitted(*arguments)
                return_freed_memory()
            ready[key], found = kept
        return found

    return call


def call_signature(arguments: tuple) -> Hashable:
    """Returns the structure of `arguments`, the arrays' shapes and types, and all other values."""
    leaves, structure = jax.tree.flatten(arguments)
    kinds = ((x.shape, x.dtype, getattr(x, "weak_type", False)) for x in leaves if eqx.is_array(x))
    return structure, *kinds, *(x for x in leaves if not eqx.is_array(x))
