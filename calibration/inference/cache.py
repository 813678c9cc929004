"""What was simulated before a run was stopped, so that the next one goes on from there."""

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

import calibration
import slider_jax
from slider_jax.io.files import input_file, replacing, tentative_folder, versions


@dataclass(frozen=True)
class Memo:
    """A folder of arrays by what they were made from. A file that cannot be read is made anew."""

    folder: Path

    def kept(
        self, name: str, arrays: Sequence[np.ndarray], make: Callable[[], list[np.ndarray]]
    ) -> list[np.ndarray]:
        """`make()`, or what it gave before under the same name and arrays."""
        digest = hashlib.sha256(name.encode())
        for array in arrays:
            digest.update(np.ascontiguousarray(array).tobytes())
        path = self.folder / f"{digest.hexdigest()}.npz"
        try:
            with path.open("rb") as file, np.load(file) as found:
                return [found[f"arr_{i}"] for i in range(len(found.files))]
        except (OSError, ValueError, KeyError, EOFError, BadZipFile):
            pass
        made = make()
        with replacing(path) as temporary:
            np.savez(temporary, *made)
        return made


def code() -> str:
    """Digest of the program's own sources."""
    digest = hashlib.sha256()
    for package in (slider_jax, calibration):
        for path in sorted(Path(str(package.__file__)).parent.rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()


def inputs(paths: Sequence[Path], folder: Path | None = None) -> dict[str, Any]:
    """Settings of a run on the files `paths`, and on the tables of an experiment's `folder`."""
    tables = sorted(folder.glob("*.csv")) if folder else []
    return {"inputs": [input_file(p) for p in (*paths, *tables)]}


@contextmanager
def resumable(out: Path, settings: dict[str, Any]) -> Iterator[Memo]:
    """A memo under `out` for a run with these settings, taken away when the run succeeds.

    A run of the same settings and program finds what a stopped one left; others begin anew.
    """
    told = json.dumps(settings | {"versions": versions(), "code": code()}, sort_keys=True)
    name = f".unfinished-{hashlib.sha256(told.encode()).hexdigest()[:16]}"
    with tentative_folder(out) as parent:
        folder = parent / name
        if folder.exists():
            print(f"going on with what a stopped run left in {folder}", file=sys.stderr)
        for other in sorted(parent.glob(".unfinished-*")):
            if other != folder:
                said = "left by a run on other data or by another program"
                print(f"{other}: {said}; may be deleted if none runs", file=sys.stderr)
        folder.mkdir(exist_ok=True)
        try:
            yield Memo(folder)
        except BaseException:
            with suppress(OSError):  # not empty
                folder.rmdir()
            raise
        shutil.rmtree(folder, ignore_errors=True)
