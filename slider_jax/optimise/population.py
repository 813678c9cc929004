"""Evaluates a population on all devices of all processes.

The population is divided into chunks of equal size. This size does not depend on the number of
devices, so the score of an individual is the same to the last bit for any number of devices.
"""

import hashlib
import io
import itertools
import json
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax._src import distributed  # private; its barrier accepts a timeout
from jax.experimental import multihost_utils
from jax.sharding import Mesh, PartitionSpec

from slider_jax.errors import InputError
from slider_jax.io.sharing import SharedFolder
from slider_jax.programs import source_digest

CHUNK = 8
"""Number of individuals that a device evaluates together. Their data fit a core's cache."""
PATIENCE = 3600
"""Longest time [s] for which a process waits for another process that still runs."""
SCORES = "scores"
"""Name of the folder with the scores that processes share."""
_meetings = itertools.count()


class Evaluation:
    """Computes `objective` for every row of a population.

    All processes must make the same calls. Devices exchange no data while they compute. If another
    program slowed one device, such an exchange would time out within seconds.
    """

    def __init__(self, objective: Callable[[jax.Array], Any], chunk: int = CHUNK):
        devices = np.array(jax.devices())
        self.rows = len(devices) * chunk
        """Number of individuals that one call of the compiled program evaluates."""
        mesh = Mesh(devices, ("devices",))
        rows = PartitionSpec("devices")
        self._compiled = jax.jit(
            jax.shard_map(
                jax.vmap(objective), mesh=mesh, in_specs=rows, out_specs=rows, check_vma=False
            )
        )
        self._sharding = jax.NamedSharding(mesh, rows)

    def __call__(self, population: np.ndarray) -> Any:
        """Returns scores (n, ...) of a population (n, d). Another n needs no recompilation."""
        n = len(population)
        filled = population[np.minimum(np.arange(-(-n // self.rows) * self.rows), n - 1)]
        parts = filled.reshape(-1, self.rows, filled.shape[-1])
        found = [self._compiled(self._given(part)) for part in parts]  # starts all computations
        scores = jax.tree.map(lambda *x: np.stack([_local(part) for part in x]), *found)
        if jax.process_count() > 1:
            barrier("scores")
            gathered = multihost_utils.process_allgather(scores)  # (processes, parts, rows, ...)
            scores = jax.tree.map(lambda x: np.swapaxes(x, 0, 1), gathered)
            scores = jax.tree.map(lambda x: x.reshape(len(parts), -1, *x.shape[3:]), scores)
        return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:])[:n], scores)

    def _given(self, part: np.ndarray) -> jax.Array:
        return jax.make_array_from_callback(part.shape, self._sharding, lambda i: part[i])


class SharedEvaluation:
    """An `Evaluation` whose parts are divided among processes that share `folder`.

    A result file contains the scores of as many individuals as one call of the program evaluates.
    The files of a population are in a folder whose name is a digest of the population, of the
    `settings` on which the scores depend, and of the source files. A process therefore never reads
    scores of another optimisation, and a resumed optimisation reads the existing scores. The
    processes need not be in the same generation.
    """

    def __init__(self, evaluation: Evaluation, folder: Path, settings: Any):
        self._evaluation, self._folder = evaluation, folder
        self._settings = json.dumps([settings, source_digest()], sort_keys=True)

    def __call__(self, population: np.ndarray) -> Any:
        """Returns scores (n, ...) of a population (n, d)."""
        rows = self._evaluation.rows
        parts = {f"part_{i:06d}": population[i : i + rows] for i in range(0, len(population), rows)}
        content = f"{rows} {self._settings}".encode() + np.ascontiguousarray(population).tobytes()
        folder = self._folder / hashlib.sha256(content).hexdigest()[:32]

        def scores(name: str) -> bytes:
            buffer = io.BytesIO()
            np.savez(buffer, *jax.tree.leaves(self._evaluation(parts[name])))
            return buffer.getvalue()

        with SharedFolder(folder) as shared:
            shared.compute(parts, scores)
        found = [np.load(io.BytesIO((folder / name).read_bytes())) for name in parts]
        values = [np.concatenate([x[key] for x in found]) for key in found[0].files]
        return values[0] if len(values) == 1 else tuple(values)


def shared_by_folder(
    evaluation: Evaluation, folder: Path | None, settings: Any
) -> Evaluation | SharedEvaluation:
    """Returns the evaluation; if `folder` is not None, all processes with this folder share it.

    Processes that JAX connects exchange their scores themselves.
    """
    if folder is None or jax.process_count() > 1:
        return evaluation
    return SharedEvaluation(evaluation, folder / SCORES, settings)


def _local(part: jax.Array) -> np.ndarray:
    """Returns the rows of `part` that this process computed."""
    shards = sorted(part.addressable_shards, key=lambda x: x.index[0].start or 0)
    return np.concatenate([np.asarray(x.data) for x in shards])


def start_devices(cores: int, coordinator: str = "", processes: int = 1, process: int = 0) -> None:
    """Configures JAX with one device for each of `cores` CPU cores, and with at least two devices.

    Call this function before any JAX computation; later calls have no effect. `coordinator` is
    the host:port of process 0 if JAX connects several processes. Raises `InputError` if connected
    processes have different numbers of cores.
    """
    with suppress(RuntimeError):
        # For one device, XLA compiles differently, and the last bit of results would differ.
        jax.config.update("jax_num_cpu_devices", max(2, cores))
    if coordinator:
        jax.config.update("jax_cpu_collectives_implementation", "gloo")
        jax.distributed.initialize(coordinator, processes, process)
        counts = np.bincount([device.process_index for device in jax.devices()])
        if len(set(counts)) > 1:
            raise InputError(
                f"processes: given {', '.join(map(str, counts))} cores; allowed is the same "
                "number for all processes; set the number with taskset or --cpus-per-task"
            )


def is_first() -> bool:
    """Returns whether this is the first process, which alone prints and writes files."""
    return jax.process_index() == 0


def barrier(place: str) -> None:
    """Waits until all processes reach this call. All processes must make the same calls."""
    if jax.process_count() > 1:
        client = distributed.global_state.client
        assert client is not None
        client.wait_at_barrier(f"{place} {next(_meetings)}", 1000 * PATIENCE)
