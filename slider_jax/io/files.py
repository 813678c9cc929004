"""Writes result files atomically, and returns versions and file digests for result files.

A file is written under a temporary name and then renamed, so no file is ever incomplete.
"""

import hashlib
import json
import os
import platform
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

import slider_jax
from slider_jax.errors import InputError

LOADED_FILES: dict[Path, str] = {}
"""SHA-256 digests of the files from which effects were loaded, at the time of loading."""


def cache_folder() -> Path:
    """Returns the user's cache folder for files that can be made again."""
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home) / "slider_jax"


@cache
def processor_features() -> str:
    """Returns the model and the features of the processor, or the name of the computer."""
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        names = ("model name", "flags", "Features", "CPU implementer", "CPU part")
        if found := sorted({x for x in lines if x.startswith(names)}):
            return " ".join(found)
    return f"{platform.machine()} {platform.processor()} {platform.node()}"


def output_folder(path: Path | str) -> Path:
    """Returns the folder `path`, created if missing. Raises `InputError` if not writable."""
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise InputError(
            f"--out {path}: is a file or is under a file; give the name of a folder"
        ) from None
    except OSError as error:
        raise InputError(f"--out {path}: cannot create the folder ({error.strerror})") from None
    if not os.access(path, os.W_OK):
        raise InputError(f"--out {path}: cannot be written to; give another folder")
    return path


@contextmanager
def tentative_folder(path: Path | str) -> Iterator[Path]:
    """Yields the output folder `path`. If an error follows, removes new empty folders."""
    path = Path(path)
    created = [p for p in (path, *path.parents) if not os.path.exists(p)]
    try:
        yield output_folder(path)
    except BaseException:
        with suppress(OSError):  # a folder is not empty
            for folder in created:
                folder.rmdir()
        raise


@contextmanager
def replacing(path: Path | str) -> Iterator[Path]:
    """Yields a temporary file next to `path`. If no error follows, renames this file to `path`."""
    path = Path(path)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=".tmp-", suffix=path.suffix)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def staged(folder: Path | str, measured: bool = False) -> Iterator[Path]:
    """Yields a temporary folder. Its files move into `folder` if no error follows.

    Raises `InputError` if an effect file has changed, as `refuse_changed_effect_files` does. With
    `measured`, the files contain measurements, which must not be lost, and this check is omitted.
    """
    with tentative_folder(folder) as out:
        stage = Path(tempfile.mkdtemp(dir=out, prefix=".tmp-"))
        try:
            yield stage
            if not measured:
                refuse_changed_effect_files()
            for item in sorted(stage.rglob("*")):
                target = out / item.relative_to(stage)
                if item.is_dir():
                    target.mkdir(exist_ok=True)
                else:
                    os.replace(item, target)
        finally:
            shutil.rmtree(stage, ignore_errors=True)


def write_bytes(path: Path | str, content: bytes) -> None:
    """Writes `content` to `path` atomically."""
    with replacing(path) as temporary:
        temporary.write_bytes(content)


def write_first(path: Path, content: bytes) -> bool:
    """Writes `content` to `path` atomically, or returns False if the file exists."""
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=".tmp-")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.chmod(temporary, 0o644)
        try:
            os.link(temporary, path)
        except FileExistsError:
            return False
        except OSError:  # a file system without hard links
            if path.exists():
                return False
            os.replace(temporary, path)
            return True
    finally:
        with suppress(FileNotFoundError):
            os.unlink(temporary)
    return True


def write_with_digest(path: Path | str, content: bytes) -> None:
    """Writes `content` to `path` atomically, after its SHA-256 digest."""
    write_bytes(path, hashlib.sha256(content).digest() + content)


def read_with_digest(path: Path) -> memoryview:
    """Returns the content of a file of `write_with_digest`.

    Raises `ValueError` if the file is damaged.
    """
    content = memoryview(path.read_bytes())
    if hashlib.sha256(content[32:]).digest() != content[:32]:
        raise ValueError(f"{path}: the file is damaged")
    return content[32:]


def write_text(path: Path | str, text: str) -> None:
    """Writes `text` to `path` atomically, as UTF-8 and with unchanged line ends."""
    write_bytes(path, text.encode())


def _plain(value: Any) -> Any:
    """Returns `value` as JSON types; numbers that are not finite become None."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


def json_text(content: Any) -> str:
    """Returns `content` as JSON; numbers that are not finite become null."""
    return json.dumps(_plain(content), indent=2, allow_nan=False) + "\n"


def write_json(path: Path | str, content: Any) -> None:
    """Writes `content` to `path` as `json_text`, atomically."""
    write_text(path, json_text(content))


def write_csv(
    path: Path | str,
    columns: Mapping[str, Sequence[float] | np.ndarray],
    formats: Mapping[str, str] | None = None,
) -> None:
    """Writes `columns` (names with units, values of equal length) to a CSV file atomically.

    `formats` contains number formats, such as ".4f", by column name. The default format is ".9g".
    A NaN becomes an empty cell.
    """
    formats = formats or {}
    cells = []
    for name, values in columns.items():
        form = formats.get(name, ".9g")
        plain = values.tolist() if isinstance(values, np.ndarray) else values
        filled = ("" if value != value else value for value in plain)
        cells.append([x if isinstance(x, str) else format(x, form) for x in filled])
    rows = [",".join(columns), *(",".join(row) for row in zip(*cells, strict=True))]
    write_text(path, "\n".join(rows) + "\n")


def versions() -> dict[str, str]:
    """Returns the versions of this package, of Python and of the numerical libraries."""
    result = {"slider_jax": slider_jax.__version__, "python": platform.python_version()}
    for name in "jax jaxlib equinox optimistix lineax numpy scipy optax evosax".split():
        try:
            result[name] = version(name)
        except PackageNotFoundError:
            result[name] = "not installed"
    return result


def input_file(path: Path | str) -> dict[str, Any]:
    """Returns the path and the SHA-256 digest of an input file, for result files."""
    path = Path(path)
    return {"path": str(path), "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}


def input_files(*paths: Path | None) -> list[dict[str, Any]]:
    """Returns `input_file` of each path that is not None."""
    return [input_file(path) for path in paths if path is not None]


def effect_files() -> list[dict[str, Any]]:
    """Returns path and SHA-256 digest of each file from which effects were loaded."""
    return [{"path": str(path), "sha256": digest} for path, digest in LOADED_FILES.items()]


def provenance() -> dict[str, Any]:
    """Returns the versions and the effect files with which a result was computed."""
    return {"versions": versions(), "effect_files": effect_files()}


def refuse_changed_effect_files() -> None:
    """Raises `InputError` if an effect file has changed since effects were loaded from it."""
    for path, digest in LOADED_FILES.items():
        try:
            changed = input_file(path)["sha256"] != digest
        except OSError:
            changed = True
        if changed:
            raise InputError(
                f"{path}: the effect file has changed or is missing since the command loaded it, "
                "so no result is written; restore the file, or repeat the command with the new file"
            )
