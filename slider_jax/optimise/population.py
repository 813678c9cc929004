"""A population's scores, computed on all devices of all processes.

Members are cut into chunks of one size, whatever the number of devices, so that every member's
score is the same to the last bit on one device and on many.
"""

import itertools
import os
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import jax
import numpy as np
from jax._src import distributed  # its barrier waits as long as it is told; a collective does not
from jax.experimental import multihost_utils
from jax.sharding import Mesh, PartitionSpec

from slider_jax.errors import InputError

CHUNK = 8
"""Members that are computed together: as many as a core's cache holds."""
PATIENCE = 3600
"""For how long a process waits for one that is late [s]; for one that ended it does not."""
_meetings = itertools.count()


class Evaluation:
    """`objective` of every row of a population. All processes must call it alike.

    Devices share nothing while they compute: one that is late, as others use its core, makes the
    rest wait, and a collective in the midst of it would give up after some seconds.
    """

    def __init__(self, objective: Callable[[jax.Array], Any], chunk: int = CHUNK):
        devices = np.array(jax.devices())
        self._rows = len(devices) * chunk
        mesh = Mesh(devices, ("devices",))
        rows = PartitionSpec("devices")
        self._compiled = jax.jit(
            jax.shard_map(
                jax.vmap(objective), mesh=mesh, in_specs=rows, out_specs=rows, check_vma=False
            )
        )
        self._sharding = jax.NamedSharding(mesh, rows)

    def __call__(self, members: np.ndarray) -> Any:
        """Scores (n, ...) of `members` (n, d), as NumPy's. One program serves every n."""
        n = len(members)
        filled = members[np.minimum(np.arange(-(-n // self._rows) * self._rows), n - 1)]
        parts = filled.reshape(-1, self._rows, filled.shape[-1])
        found = [self._compiled(self._given(part)) for part in parts]  # all are begun at once
        scores = jax.tree.map(lambda *x: np.stack([_local(part) for part in x]), *found)
        if jax.process_count() > 1:
            barrier("scores")
            gathered = multihost_utils.process_allgather(scores)  # (processes, parts, rows, ...)
            scores = jax.tree.map(lambda x: np.swapaxes(x, 0, 1), gathered)
            scores = jax.tree.map(lambda x: x.reshape(len(parts), -1, *x.shape[3:]), scores)
        return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:])[:n], scores)

    def _given(self, part: np.ndarray) -> jax.Array:
        return jax.make_array_from_callback(part.shape, self._sharding, lambda i: part[i])


def _local(part: jax.Array) -> np.ndarray:
    """The rows that this process has."""
    shards = sorted(part.addressable_shards, key=lambda x: x.index[0].start or 0)
    return np.concatenate([np.asarray(x.data) for x in shards])


def start_devices(cores: int, coordinator: str = "", processes: int = 1, process: int = 0) -> None:
    """Make JAX see a device for each of `cores` of a CPU, two at least. Call it first of all.

    `coordinator` is the host:port of process 0 where there are several; under srun they find each
    other, and the arguments are left out. Where JAX has begun to compute, its devices stay.
    """
    # Of a job step: the batch script itself, which is one process, has no such variable above 1.
    slurm = int(os.environ.get("SLURM_STEP_NUM_TASKS", "1")) > 1
    with suppress(RuntimeError):
        # A program for one device is compiled otherwise, and differs in the last bit.
        jax.config.update("jax_num_cpu_devices", max(2, cores))
    if coordinator or slurm:
        jax.config.update("jax_cpu_collectives_implementation", "gloo")
        found = (coordinator, processes, process) if coordinator else ()
        jax.distributed.initialize(*found)
        counts = np.bincount([device.process_index for device in jax.devices()])
        if len(set(counts)) > 1:
            raise InputError(
                f"processes: have {', '.join(map(str, counts))} cores; allowed are as many for "
                "each: give the larger ones fewer, by taskset or --cpus-per-task"
            )


def is_first() -> bool:
    """Whether this is the process that speaks and writes."""
    return jax.process_index() == 0


def barrier(place: str) -> None:
    """Wait for all processes to come here, the same number of times each."""
    if jax.process_count() > 1:
        client = distributed.global_state.client
        assert client is not None
        client.wait_at_barrier(f"{place} {next(_meetings)}", 1000 * PATIENCE)
