"""Cache of simulated readings, so that an interrupted run can resume."""

import hashlib
import json
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from slider_jax.io.files import effect_files, input_file, replacing, tentative_folder, versions
from slider_jax.programs import source_digest


@dataclass(frozen=True)
class Memo:
    """A folder of cached arrays. The name of a file is a digest of the computation's inputs."""

    folder: Path

    def cached(
        self, name: str, arrays: Sequence[np.ndarray], make: Callable[[], list[np.ndarray]]
    ) -> list[np.ndarray]:
        """Returns the cached result for `name` and `arrays`, or stores and returns `make()`."""
        found = self.load(name, arrays)
        if found is None:
            found = make()
            self.store(name, arrays, found)
        return found

    def load(self, name: str, arrays: Sequence[np.ndarray]) -> list[np.ndarray] | None:
        """Returns the cached result, or None if there is no file or if it is damaged."""
        try:
            with self._path(name, arrays).open("rb") as file, np.load(file) as found:
                return [found[f"arr_{i}"] for i in range(len(found.files))]
        except (OSError, ValueError, KeyError, EOFError, BadZipFile):
            return None

    def store(self, name: str, arrays: Sequence[np.ndarray], made: Sequence[np.ndarray]) -> None:
        """Stores the result `made` for `name` and `arrays`."""
        with replacing(self._path(name, arrays)) as temporary:
            np.savez(temporary, *made)

    def _path(self, name: str, arrays: Sequence[np.ndarray]) -> Path:
        digest = hashlib.sha256(name.encode())
        for array in arrays:
            digest.update(np.ascontiguousarray(array).tobytes())
        return self.folder / f"{digest.hexdigest()}.npz"


def cached(
    memo: Memo | None, name: str, arrays: Sequence[np.ndarray], make: Callable[[], list[np.ndarray]]
) -> list[np.ndarray]:
    """Returns `memo.cached(name, arrays, make)`, or `make()` if `memo` is None."""
    return make() if memo is None else memo.cached(name, arrays, make)


def cached_each(
    memo: Memo | None,
    keys: Sequence[tuple[str, Sequence[np.ndarray]]],
    make: Callable[[list[int]], list[np.ndarray]],
) -> list[np.ndarray]:
    """Returns an array for each (name, arrays) in `keys`; each has a cache entry of its own.

    `make(missing)` computes the arrays that the cache does not contain, from their positions in
    `keys`.
    """
    found: dict[int, np.ndarray] = {}
    for i, key in enumerate(keys):
        stored = None if memo is None else memo.load(*key)
        if stored is not None:
            found[i] = stored[0]
    missing = [i for i in range(len(keys)) if i not in found]
    if missing:
        for i, made in zip(missing, make(missing), strict=True):
            found[i] = made
            if memo is not None:
                memo.store(*keys[i], [made])
    return [found[i] for i in range(len(keys))]


def _digest(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]


def input_settings(paths: Sequence[Path], folder: Path | None = None) -> dict[str, Any]:
    """Returns digests of the input files `paths` and of all CSV and NPZ files in `folder`."""
    tables = sorted([*folder.glob("*.csv"), *folder.glob("*.npz")]) if folder else []
    return {"inputs": [input_file(p) for p in (*paths, *tables)]}


@contextmanager
def resumable(out: Path, settings: dict[str, Any]) -> Iterator[Memo]:
    """Yields a cache under `out` for a run with `settings`; deletes the cache if the run succeeds.

    A run with the same settings, program version and effect files resumes with the cache of an
    interrupted run.
    """
    run = f".unfinished-{_digest(settings | {'versions': versions(), 'code': source_digest()})}"
    name = f"{run}-{_digest(effect_files())}"
    with tentative_folder(out) as parent:
        folder = parent / name
        if folder.exists():
            print(f"resuming the interrupted run from {folder}", file=sys.stderr)
        for other in sorted(parent.glob(".unfinished-*")):
            if other != folder:
                cause = "cache of a run with other settings, data or program version"
                if other.name.startswith(run):
                    cause = (
                        "cache of this run with other effect files or with other content of these "
                        "files, so this run starts from the beginning"
                    )
                print(f"{other}: {cause}; delete the folder if that run has ended", file=sys.stderr)
        folder.mkdir(exist_ok=True)
        try:
            yield Memo(folder)
        except BaseException:
            with suppress(OSError):  # removes the folder only if it is empty
                folder.rmdir()
            raise
        shutil.rmtree(folder, ignore_errors=True)
