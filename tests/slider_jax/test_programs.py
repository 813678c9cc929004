"""Compiled programs in files: a later process loads them, and no program of other sources."""

import os
import platform
import subprocess
import sys
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental.compilation_cache import compilation_cache

from calibration.model.compiled import compiled_batch
from slider_jax import programs
from slider_jax.programs import (
    UNUSED_DAYS,
    all_programs_kept,
    compiled_once,
    compiled_programs,
    kept_programs,
)

TRACED = []


def scaled(x, factor):
    """Returns a tree; `TRACED` counts how often the function is traced."""
    TRACED.append(factor)
    return {"value": factor * x, "pair": (x.sum(), jnp.arange(3))}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The folder of the programs, empty at the start."""
    before = jax.config.values["jax_compilation_cache_dir"]
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    TRACED.clear()
    yield tmp_path / programs.FOLDER
    jax.config.update("jax_compilation_cache_dir", before)


def files(folder):
    return sorted(path for path in folder.rglob("*") if path.is_file())


def later_process(x, factor):
    """Returns the result of a new wrapper, which has no program in memory."""
    with kept_programs():
        return compiled_once(scaled)(x, factor)


def test_a_later_process_loads_the_program_without_tracing(folder):
    x = jnp.arange(4.0)
    first = later_process(x, 2.0)
    assert TRACED == [2.0] and len(files(folder)) == 1
    second = later_process(x + 1.0, 2.0)
    assert TRACED == [2.0]
    np.testing.assert_array_equal(first["value"], 2.0 * np.arange(4.0))
    np.testing.assert_array_equal(second["value"], 2.0 * np.arange(1.0, 5.0))
    assert second["pair"][0] == 10.0 and second["pair"][1].tolist() == [0, 1, 2]


def test_each_call_of_a_compiled_or_loaded_program_uses_its_own_arguments(folder):
    for _ in range(2):  # the second program is loaded
        with kept_programs():
            call = compiled_once(scaled)
            for x in (jnp.arange(4.0), jnp.arange(1.0, 5.0), jnp.ones(4)):
                np.testing.assert_array_equal(call(x, 2.0)["value"], 2.0 * x)
    assert TRACED == [2.0]


@pytest.mark.parametrize("given", [(np.arange(4.0), 3.0), (np.arange(5.0), 2.0)])
def test_other_values_and_shapes_have_other_programs(folder, given):
    later_process(jnp.arange(4.0), 2.0)
    np.testing.assert_array_equal(later_process(*given)["value"], given[1] * given[0])
    assert len(TRACED) == 2 and len(files(folder)) == 2


def test_a_batch_is_another_program_than_its_function(folder):
    x = jnp.arange(8.0).reshape(1, 8)
    later_process(x, 2.0)
    with kept_programs():
        found = compiled_batch(scaled)((2.0,), x)
    np.testing.assert_array_equal(found["value"], 2.0 * x)
    assert len(files(folder)) == 2


@pytest.mark.parametrize("content", [b"", b"torn", None])
def test_a_torn_file_is_compiled_again(folder, content):
    x = jnp.arange(4.0)
    later_process(x, 2.0)
    (path,) = files(folder)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2] if content is None else content)
    np.testing.assert_array_equal(later_process(x, 2.0)["value"], 2.0 * x)
    assert TRACED == [2.0, 2.0]


def loaded_by_jax(x, factor):
    """Reports a hit of JAX's cache while it is compiled, as JAX does."""
    jax.monitoring.record_event("/jax/compilation_cache/cache_hits")
    return factor * x


def test_a_program_from_the_cache_of_jax_is_not_stored(folder):
    """XLA would store it without its machine code."""
    with kept_programs():
        found = compiled_once(loaded_by_jax)(jnp.arange(4.0), 2.0)
    np.testing.assert_array_equal(found, 2.0 * np.arange(4.0))
    assert not files(folder)


@pytest.mark.parametrize(
    "changed", ["source_digest", "versions", "_settings", "processor_features"]
)
def test_programs_of_other_sources_versions_and_settings_are_not_loaded(
    folder, changed, monkeypatch
):
    later_process(jnp.arange(4.0), 2.0)
    monkeypatch.setattr(programs, changed, lambda: 20 * "f")
    later_process(jnp.arange(4.0), 2.0)
    assert TRACED == [2.0, 2.0]


def test_nothing_is_stored_while_effects_of_other_files_are_loaded(folder, monkeypatch):
    monkeypatch.setattr(programs, "effect_files", lambda: [{"path": "own.py"}])
    later_process(jnp.arange(8.0), 2.0)
    assert not files(folder)


def test_nothing_is_stored_if_a_source_file_changed_meanwhile(folder, monkeypatch):
    with kept_programs():
        monkeypatch.setattr(programs, "source_digest", lambda: 20 * "f")
        compiled_once(scaled)(jnp.arange(9.0), 2.0)
    assert not files(folder)


def test_functions_and_objects_that_texts_do_not_tell_apart_are_not_stored(folder):
    def nested(x, factor):
        return factor * x

    with kept_programs():
        compiled_once(nested)(jnp.arange(4.0), 2.0)
        compiled_once(lambda x, _: 2.0 * x)(jnp.arange(4.0), object())
    assert not files(folder)


def test_nothing_is_stored_outside_the_context_or_without_the_cache(folder):
    compiled_once(scaled)(jnp.arange(6.0), 2.0)
    jax.config.update("jax_enable_compilation_cache", False)
    try:
        later_process(jnp.arange(7.0), 2.0)
    finally:
        jax.config.update("jax_enable_compilation_cache", True)
    assert not files(folder)


def test_programs_of_old_sources_are_deleted(folder):
    old, recent, other = folder / (16 * "a"), folder / (16 * "b"), folder / "of_the_user"
    for path, days in ((old, UNUSED_DAYS + 1.0), (recent, UNUSED_DAYS - 1.0), (other, 99.0)):
        path.mkdir(parents=True)
        os.utime(path, (time.time() - 86400.0 * days,) * 2)
    later_process(jnp.arange(4.0), 2.0)
    assert not old.exists() and recent.exists() and other.exists()


def test_freed_memory_is_returned_once_after_each_new_program(monkeypatch):
    calls = []
    monkeypatch.setattr(programs, "return_freed_memory", lambda: calls.append(1))
    double = compiled_once(lambda x: 2.0 * x)
    for size in (3, 3, 4, 3):
        np.testing.assert_array_equal(double(np.ones(size)), 2.0 * np.ones(size))
    assert len(calls) == 2


def test_a_program_within_another_program_is_not_stored(folder):
    double = compiled_once(lambda x: 2.0 * x)
    with kept_programs():
        np.testing.assert_array_equal(jax.jit(double)(jnp.arange(4.0)), 2.0 * jnp.arange(4.0))
        assert jax.grad(lambda x: double(x))(1.5) == 2.0
    assert not files(folder)


def cubed(x):
    """Returns the cube; only `test_a_program_of_the_cache_of_jax_is_compiled_again` uses it."""
    return x * x * x + 0.625


def test_a_program_of_the_cache_of_jax_is_compiled_again(folder):
    """Otherwise, each later process would trace it."""
    before = jax.config.values["jax_persistent_cache_min_compile_time_secs"]
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    compilation_cache.reset_cache()
    try:
        later_cube()
        for path in files(folder):
            path.unlink()
        jax.clear_caches()
        later_cube()
        assert not files(folder)
        jax.clear_caches()
        with all_programs_kept():
            later_cube()
        assert len(files(folder)) == 1
        assert {*files(folder)} < compiled_programs()
    finally:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", before)
        compilation_cache.reset_cache()


def later_cube():
    with kept_programs():
        np.testing.assert_array_equal(compiled_once(cubed)(jnp.ones(3)), 1.625 * np.ones(3))


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="needs GNU libc")
def test_large_arrays_return_their_memory():
    """After the first freed array, GNU libc keeps every freed array that lies between others."""
    code = """
import os, sys
import numpy as np
from slider_jax.programs import return_large_arrays

def memory():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20

if sys.argv[1] == "returned":
    return_large_arrays()
np.ones(2**21)
arrays = [np.ones(2**20) for _ in range(40)]
before = memory()
del arrays[::2]
print(before - memory())
"""
    default, returned = (float(_output_of(code, x)) for x in ("default", "returned"))
    assert default < 20.0 and returned > 140.0


def _output_of(code: str, *arguments: str) -> str:
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout
