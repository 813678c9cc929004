"""The library of effects: a dictionary from names to classes. This module imports all effects."""

import importlib
import importlib.util
import inspect
import sys
from pathlib import Path
from pkgutil import walk_packages
from types import ModuleType

from slider_jax import effects
from slider_jax.effects.base import Effect
from slider_jax.errors import InputError


def defined_effects(module: ModuleType) -> list[type[Effect]]:
    """Returns the concrete effects that `module` defines, such as a subclass of `Flow`."""
    kinds = [x for x in vars(module).values() if isinstance(x, type) and issubclass(x, Effect)]
    kinds = [x for x in kinds if x.__module__ == module.__name__ and not inspect.isabstract(x)]
    return [x for x in kinds if Effect not in (x, *x.__bases__)]


def _built_in() -> dict[str, type[Effect]]:
    """Returns the effects of this package, except the effects that every model contains."""
    found = [m.name for m in walk_packages(effects.__path__, f"{effects.__name__}.")]
    modules = [importlib.import_module(name) for name in found if name != __name__]
    kinds = [kind for module in modules for kind in defined_effects(module)]
    kinds.sort(key=lambda kind: (kind.order, kind.name()))
    return {kind.name(): kind for kind in kinds if not kind.in_every_model}


LIBRARY: dict[str, type[Effect]] = _built_in()
LOADED_FILES: list[Path] = []
"""Files from which `load_effects` added effects to the library."""


def load_effects(path: Path) -> list[str]:
    """Adds the effects that the Python file `path` defines to `LIBRARY`, and returns their names.

    The file runs as Python code, so load only files that you trust. Raises `InputError` and adds no
    effect if the file cannot be imported or defines no effect, or if one of the effects is invalid.
    An effect is invalid if it has no title or no parameter, if a null or the default of a shape
    parameter is outside the prior range, or if another effect has the same name.
    """
    module_name = f"_effects_of_{path.stem}"
    spec = importlib.util.spec_from_file_location(module_name, path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path}: is not a Python file; give a file whose name ends in .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module  # dataclasses look up annotations in sys.modules
    try:
        spec.loader.exec_module(module)
        kinds = defined_effects(module)
        _check_effects(path, kinds)
    except InputError:
        raise
    except SyntaxError as error:
        raise InputError(f"{path}: line {error.lineno}: invalid Python: {error.msg}") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except Exception as error:  # the file's own code may raise anything
        kind = type(error).__name__
        raise InputError(f"{path}: cannot be imported: {kind}: {error}") from error
    finally:
        del sys.modules[module_name]
    LIBRARY.update({kind.name(): kind for kind in kinds})
    LOADED_FILES.append(path.resolve())
    return [kind.name() for kind in kinds]


def _check_effects(path: Path, kinds: list[type[Effect]]) -> None:
    """Raises `InputError` if the file `path` defines no effect or an invalid effect."""
    if not kinds:
        raise InputError(
            f"{path}: defines no effect; define a class that is derived from a base class of "
            "slider_jax.effects, and define the abstract method of the base class"
        )
    for kind in kinds:
        where = f"{path}: {kind.__name__}"
        if kind.name() in LIBRARY:
            raise InputError(f"{where}: the effect {kind.name()!r} exists; change the class name")
        if not kind.title:
            raise InputError(f'{where}: has no title; add title = "name of the effect in reports"')
        if not kind.priors():
            raise InputError(
                f"{where}: has no parameter with null and prior range; declare a field with "
                "parameter(null, low, high, unit, why)"
            )
        for noun, priors in (("null", kind.priors()), ("default", kind.shapes())):
            for name, prior in priors.items():
                if not (prior.low <= prior.null <= prior.high and prior.low < prior.high):
                    raise InputError(
                        f"{where}.{name}: given {noun} {prior.null:g}, prior {prior.low:g} to "
                        f"{prior.high:g}; allowed are low < high and a {noun} in this range"
                    )
