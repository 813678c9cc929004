"""Parallel simulation of many independent members, as chunks of a batch in threads.

A chunk of about eight members fits the cache of a core, so it costs less per member than one large
batch. One chunk per thread uses every core, since XLA runs compiled programs outside Python's lock.
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
    """`total` chunks of `size` members; repetitions of the last member fill the last chunk."""

    members: int
    size: int
    total: int
    workers: int

    def indices(self, chunk: int) -> np.ndarray:
        """Indices of the members in `chunk`; the last chunk may repeat an index."""
        start = chunk * self.size
        return np.minimum(np.arange(start, start + self.size), self.members - 1)

    def real(self, chunk: int) -> int:
        """Number of members in `chunk` without repetitions."""
        return min(self.size, self.members - chunk * self.size)


def chunks_of(members: int, size: int = 8, workers: int | None = None) -> Chunks:
    """Chunks of at most `size`, balanced so all workers (default: one per core) end together."""
    workers = min(workers or available_cores(), members)
    rounds = -(-members // (size * workers))
    size = -(-members // (rounds * workers))
    return Chunks(members, size, -(-members // size), workers)


def available_cores() -> int:
    """Number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def stack(trees: list[Any]) -> Any:
    """One tree with the members along a new first axis of its leaves, in the default float type."""
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(x, float) for x in leaves]), *trees)


def take(tree: Any, indices: np.ndarray) -> Any:
    """The members `indices` of a stacked tree."""
    return jax.tree.map(lambda x: x[indices], tree)


def in_threads(
    work: Callable[[int, Callable[[], bool]], Any], chunks: list[int], workers: int
) -> Iterator[tuple[int, Any]]:
    """Yields (chunk, result) of `work(chunk, stopped)` in the order of completion.

    If a chunk fails or the caller leaves the loop, chunks that have not started are cancelled.
    `stopped()` then returns true in the running chunks.
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
