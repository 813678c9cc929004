"""Compiles functions for batches of trials, and adds tangents to functions."""

from collections.abc import Callable, Hashable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

from slider_jax.batch.chunks import available_cores
from slider_jax.programs import compiled_once

MOST_MAPS = 40_000
"""Largest number of memory maps of a process between two analyses. Linux allows 65,530 by default,
and the next analysis needs maps too."""
DIRECTIONS = 8
"""A call of a compiled program computes a multiple of this number of tangents."""
MOST_DIRECTIONS = 64
"""Largest number of tangents that one call computes. 64 tangents take twice the time of eight."""
LONG, FULL_SHARE = 20_000, 0.6
"""A batch with an item of at least the length `LONG` is computed one item at a time if its items
fill less than the fraction `FULL_SHARE` of it. A batch of four halves the time per item, but one
more compiled program is only worth its time for long items."""
MOST_VALUES = 2**22
"""Largest number of values that one operation on several series copies (32 MiB)."""


def limit_memory_maps() -> None:
    """Clears JAX's caches of compiled programs if this process has over `MOST_MAPS` memory maps.

    Each compiled program has memory maps of its own. If a process needs more maps than the
    operating system allows, XLA aborts the process. Call this function between analyses if one
    process analyses dozens of experiments. Later calls compile their programs again, except the
    programs that `kept_programs` keeps.
    """
    maps = Path("/proc/self/maps")
    if maps.exists() and len(maps.read_bytes().splitlines()) > MOST_MAPS:
        jax.clear_caches()


def compiled_batch(function):
    """Returns the compiled batch of `function`, called as batch(static arguments, *arguments).

    The first axis of each array in `arguments` is the trial. A single trial is not batched, because
    the program without a batch axis compiles and runs faster.
    """

    def batch(static, *trials):
        if all(len(x) == 1 for x in jax.tree.leaves(trials)):
            found = function(*jax.tree.map(lambda x: x[0], trials), *static)
            return jax.tree.map(lambda x: x[None], found)
        return eqx.filter_vmap(lambda *trial: function(*trial, *static))(*trials)

    # A stored program is found by the name of its function.
    batch.__module__, batch.__qualname__ = function.__module__, f"batch of {function.__qualname__}"
    return compiled_once(batch)


def with_tangents(function, arguments, directions):
    """Returns the value of function(*arguments), and the value's tangents along `directions`.

    Each array of `directions` has the axes of its argument after a first axis of directions.
    """
    dynamic, static = eqx.partition(arguments, eqx.is_inexact_array)

    def value(dynamic):
        out = function(*eqx.combine(dynamic, static))
        moving, fixed = eqx.partition(out, eqx.is_inexact_array)
        return moving, fixed

    def one(direction):
        return jax.jvp(value, (dynamic,), (direction,), has_aux=True)

    moving, tangents, fixed = jax.vmap(one, out_axes=(None, 0, None))(directions)
    return eqx.combine(moving, fixed), tangents


def rows_per_call(k: int) -> int:
    """Returns the number of directions in each call that computes a part of `k` tangents."""
    calls = -(-k // MOST_DIRECTIONS)
    return DIRECTIONS * -(-k // (DIRECTIONS * calls))


def slices(count: int, values: int, multiple: int = 1) -> list[slice]:
    """Returns slices of `count` rows, so that a slice has at most `MOST_VALUES` values.

    Each row has the number `values` of values. A slice has at least `multiple` rows, and except for
    the last slice, its number of rows is a multiple of `multiple`.
    """
    rows = multiple * max(1, MOST_VALUES // (multiple * max(values, 1)))
    return [slice(first, min(first + rows, count)) for first in range(0, count, rows)]


def by_directions(
    function: Callable[[np.ndarray], Any], directions: np.ndarray, rows: int | None = None
) -> Iterator[tuple[slice, np.ndarray]]:
    """Yields slices of the `directions` (k, n), and `function` of them, computed in several calls.

    Each call has the number `rows` of directions (default: `rows_per_call`, a multiple of
    `DIRECTIONS`, so that few programs are compiled). The last row is repeated to fill a call.
    """
    k = len(directions)
    rows = rows_per_call(max(k, 1)) if rows is None else rows
    padded = np.pad(directions, ((0, -k % rows), (0, 0)), mode="edge")
    for first in range(0, k, rows):
        here = slice(first, min(first + rows, k))
        yield here, np.asarray(function(padded[first : first + rows]))[: here.stop - first]


def stacked(trees: Sequence[Any]) -> Any:
    """Returns one tree whose arrays are those of all `trees`, along a new first axis."""
    return jax.tree.map(lambda *x: np.stack(x), *trees)


def structure_of(tree: Any) -> Hashable:
    """Returns the structure and shapes of a tree. Trees that can be stacked have the same."""
    leaves, structure = jax.tree.flatten(tree)
    return structure, *(np.shape(x) for x in leaves)


def in_batches(
    work: Callable[[list], list],
    items: Sequence[Any],
    kinds: Sequence[Hashable],
    lengths: Sequence[int],
    size: int,
) -> list:
    """Returns the result of `work` for each item, computed in batches of `size` on all cores.

    The items of one batch are of the same kind. The longest items come first. A batch that is not
    full repeats its last item, or is split into its items (`LONG`).
    """
    groups: dict[Hashable, list[int]] = {}
    for i in sorted(range(len(items)), key=lambda i: -lengths[i]):
        groups.setdefault(kinds[i], []).append(i)
    jobs: list[tuple[list[int], int]] = []
    for batch in [x[i : i + size] for x in groups.values() for i in range(0, len(x), size)]:
        longest, filled = lengths[batch[0]], sum(lengths[i] for i in batch)
        split = longest >= LONG and filled < FULL_SHARE * size * longest
        jobs += [([i], 1) for i in batch] if split else [(batch, size)]
    jobs.sort(key=lambda job: -lengths[job[0][0]])

    def one(job: tuple[list[int], int]) -> list:
        batch, slots = job
        full = batch + [batch[-1]] * (slots - len(batch))
        return work([items[i] for i in full])[: len(batch)]

    found: dict[int, Any] = {}
    for (batch, _), results in zip(jobs, on_all_cores(one, jobs), strict=True):
        found |= dict(zip(batch, results, strict=True))
    return [found[i] for i in range(len(items))]


def on_all_cores(work, items: list) -> list:
    """Returns `work(item)` for every item, in the order of `items`, with one thread per core."""
    with ThreadPoolExecutor(max_workers=available_cores()) as pool:
        return list(pool.map(work, items))


@contextmanager
def background_thread() -> Iterator[ThreadPoolExecutor]:
    """Yields one thread for work that may be dropped; work that has not begun at the end is."""
    pool = ThreadPoolExecutor(1)
    try:
        yield pool
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
