"""The library of effects: a dictionary from names to classes. This module imports all effects.

A model file may also contain terms of `DICTIONARY` and their details. These terms describe a
residual that no effect of the library explains. They are no physical causes, so they are not in the
library. Few commands need them, and their classes take a third of a second to make. The first
access to `DICTIONARY`, or to an unknown name in `KNOWN_EFFECTS`, makes them.
"""

import hashlib
import importlib
import sys
from collections import ChainMap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from importlib.metadata import entry_points
from pathlib import Path
from pkgutil import walk_packages
from types import ModuleType

from slider_jax import effects
from slider_jax.effects.base import Effect
from slider_jax.effects.check import checked_effects, defined_effects, is_complete
from slider_jax.errors import InputError
from slider_jax.io.files import LOADED_FILES

ENTRY_POINTS = "slider_jax.effects"
"""Group of the entry points with which an installed package names its modules of effects."""


Kinds = dict[str, type[Effect]]


class LaterEffects(Mapping[str, type[Effect]]):
    """Effects by name, which the function `make` makes at the first access."""

    def __init__(self, make: Callable[[], Kinds]):
        self._make = make

    @cached_property
    def _made(self) -> Kinds:
        return self._make()

    def __getitem__(self, name: str) -> type[Effect]:
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._made)

    def __len__(self) -> int:
        return len(self._made)


OF_DICTIONARY = f"{effects.__name__}.dictionary"


def _built_in(of_dictionary: bool) -> Kinds:
    """Returns the effects of this package by name, including effects of every model."""
    names = [m.name for m in walk_packages(effects.__path__, f"{effects.__name__}.")]
    names = [x for x in names if x != __name__ and x.startswith(OF_DICTIONARY) == of_dictionary]
    modules = [importlib.import_module(name) for name in names]
    kinds = [kind for module in modules for kind in defined_effects(module) if is_complete(kind)]
    kinds.sort(key=lambda kind: (kind.order, kind.name()))
    return {kind.name(): kind for kind in kinds}


def _terms() -> Kinds:
    from slider_jax.effects.dictionary.details import REAR_READINGS

    kinds = _built_in(of_dictionary=True)
    return {k: x for k, x in kinds.items() if x.term_curve is not None} | REAR_READINGS


def _details() -> Kinds:
    from slider_jax.effects.dictionary.details import DETAILS

    return DETAILS


_PHYSICAL = _built_in(of_dictionary=False)
DICTIONARY = LaterEffects(_terms)
"""The terms from which `slider close-loop` learns, by name."""
LIBRARY: Kinds = {k: x for k, x in _PHYSICAL.items() if not x.in_every_model}
"""The physical effects by name, including the effects of the user's files."""
KNOWN_EFFECTS: Mapping[str, type[Effect]] = ChainMap(
    LIBRARY,
    DICTIONARY,  # type: ignore[arg-type]
    LaterEffects(_details),  # type: ignore[arg-type]
)
"""All effects that a model file may contain, by name."""
_HOMES = dict.fromkeys(_PHYSICAL, "slider_jax")
"""The file or package that defines each effect, for messages."""


def load_effects(path: Path) -> list[str]:
    """Adds the effects that the Python file `path` defines to `LIBRARY`, and returns their names.

    The file runs as Python code, so load only files that you trust. Raises `InputError` and adds no
    effect if the file cannot be imported, or if `checked_effects` refuses one of the effects.
    """
    if path.suffix != ".py":
        raise InputError(f"{path}: is not a Python file; give a file whose name ends in .py")
    module = ModuleType(f"_effects_of_{path.stem}")
    module.__file__ = str(path)
    try:
        source = path.read_bytes()
        code = compile(source, str(path), "exec")
    except SyntaxError as error:
        raise InputError(f"{path}: line {error.lineno}: invalid Python: {error.msg}") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    sys.modules[module.__name__] = module  # dataclasses look up annotations in sys.modules
    try:
        # Python's cache of compiled files could be older than `source`, so `exec` runs the source.
        exec(code, vars(module))
    except (Exception, SystemExit) as error:  # the file's own code may raise anything
        raise _cannot_be_imported(str(path), error) from error
    finally:
        del sys.modules[module.__name__]
    return _add(module, str(path), {path: source})


def load_installed_effects() -> list[str]:
    """Adds the effects of installed packages to `LIBRARY`, and returns the names of new effects.

    A package names a module of effects with an entry point of the group `slider_jax.effects`.
    Raises `InputError` if a module cannot be imported, or if an effect is invalid.
    """
    added = []
    for entry in sorted(entry_points(group=ENTRY_POINTS), key=lambda x: (x.value, x.name)):
        where = f"entry point {entry.name} = {entry.value} (group {ENTRY_POINTS})"
        try:
            module = entry.load()
        except Exception as error:  # the package's own code may raise anything
            raise _cannot_be_imported(where, error) from error
        if not isinstance(module, ModuleType):
            raise InputError(f"{where}: names no module; give the module that defines the effects")
        # The effects of a package are already in the library if the function ran before.
        if not any(kind in LIBRARY.values() for kind in defined_effects(module)):
            added += _add(module, where, {path: path.read_bytes() for path in _sources(module)})
    return added


def load_all_effects(files: Iterable[Path]) -> None:
    """Adds the effects of installed packages and of `files` to `LIBRARY`, as the commands do."""
    load_installed_effects()
    for path in files:
        load_effects(path)


def _cannot_be_imported(where: str, error: BaseException) -> InputError:
    text = " ".join(str(error).split())
    return InputError(f"{where}: cannot be imported: {type(error).__name__}: {text}")


def _sources(module: ModuleType) -> Sequence[Path]:
    """Returns the source files of the top-level package that contains `module`."""
    top = sys.modules[module.__name__.split(".")[0]]
    folders = [Path(folder) for folder in getattr(top, "__path__", ())]
    files = [path for folder in folders for path in sorted(folder.rglob("*.py"))]
    return files or [Path(str(module.__file__))]


def _add(module: ModuleType, where: str, sources: dict[Path, bytes]) -> list[str]:
    taken = {name: _HOMES.get(name, "slider_jax") for name in (*KNOWN_EFFECTS, *_PHYSICAL)}
    kinds = checked_effects(module, where, taken)
    LIBRARY.update({kind.name(): kind for kind in kinds})
    _HOMES.update({kind.name(): where for kind in kinds})
    for path, source in sources.items():
        LOADED_FILES[path.resolve()] = hashlib.sha256(source).hexdigest()
    return [kind.name() for kind in kinds]
