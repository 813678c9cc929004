"""Where a result came from: versions of the programs, and the input's digest."""

import hashlib
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import slider_jax

_PACKAGES = (
    "jax",
    "jaxlib",
    "equinox",
    "optimistix",
    "lineax",
    "numpy",
    "scipy",
    "optax",
    "evosax",
)


def versions() -> dict[str, str]:
    """Versions of this package, of Python and of the libraries that compute."""
    found = {"slider_jax": slider_jax.__version__, "python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def input_file(path: Path | str) -> dict[str, Any]:
    """Path and sha256 of an input, for the results made from it."""
    path = Path(path)
    return {"path": str(path), "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
