"""Many independent members on the cores of one machine: chunks of a batch, in threads.

A chunk of about eight members fits a core's cache, so it costs less per member than one large
batch. A chunk to a thread keeps every core busy: XLA runs compiled programs outside Python's lock.
"""

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np


class Chunks(NamedTuple):
    """`total` chunks of `size` members; the last is filled up by repeating the last member."""

    members: int
    size: int
    total: int
    workers: int

    def indices(self, chunk: int) -> np.ndarray:
        """Which members fill `chunk`; an index may repeat in the last."""
        start = chunk * self.size
        return np.minimum(np.arange(start, start + self.size), self.members - 1)

    def real(self, chunk: int) -> int:
        """How many of them are not filling."""
        return min(self.size, self.members - chunk * self.size)


def chunks_of(members: int, size: int = 8, workers: int | None = None) -> Chunks:
    """Chunks of at most `size`, evened out so that all workers (default: cores) end together."""
    workers = min(workers or available_cores(), members)
    rounds = -(-members // (size * workers))
    size = -(-members // (rounds * workers))
    return Chunks(members, size, -(-members // size), workers)


def available_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def stack(trees: list[Any]) -> Any:
    """One tree whose leaves carry the members along a new first axis, in the default float type."""
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(x, float) for x in leaves]), *trees)


def take(tree: Any, indices: np.ndarray) -> Any:
    """The members `indices` of a stacked tree."""
    return jax.tree.map(lambda x: x[indices], tree)


def in_threads(
    work: Callable[[int, Callable[[], bool]], Any], chunks: list[int], workers: int
) -> Iterator[tuple[int, Any]]:
    """(chunk, result) of `work(chunk, stopped)` as each is done.

    An error, or an end of the loop before the last, drops chunks not begun and makes `stopped()`
    true for those under way.
    """
    stop = threading.Event()
    pool = ThreadPoolExecutor(max_workers=workers)
    try:
        futures = {pool.submit(work, chunk, stop.is_set): chunk for chunk in chunks}
        for future in as_completed(futures):
            yield futures[future], future.result()
    finally:
        stop.set()
        pool.shutdown(wait=True, cancel_futures=True)
