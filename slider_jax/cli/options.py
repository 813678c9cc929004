"""Types of command-line arguments: their names in the help, and what a bad one is told."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tyro.constructors import PrimitiveConstructorSpec

from slider_jax.errors import InputError


def _read_by(
    read: Callable[[list[str]], Any], metavar: str, allowed: str, count: int | Literal["*"] = 1
) -> PrimitiveConstructorSpec:
    """How an argument of `count` words is read, and its `metavar` in the help.

    `read` takes the words and raises `ValueError` where they are not what is `allowed`.
    """

    def instance(words: list[str]) -> Any:
        try:
            return read(words)
        except ValueError:
            given = " ".join(words)
            raise ValueError(f"given {given!r}; allowed {allowed}") from None

    return PrimitiveConstructorSpec(
        nargs=count,
        metavar=metavar,
        instance_from_str=instance,
        is_instance=lambda x: True,
        str_from_instance=lambda x: list(map(str, x)) if isinstance(x, tuple) else [str(x)],
    )


def _number(words: list[str]) -> float:
    return float(words[0])


def _whole(words: list[str]) -> int:
    return int(words[0])


def _numbers(words: list[str]) -> tuple[float, ...]:
    return tuple(map(float, words))


_DEFAULT_IN_HELP = tyro.conf.arg(help_behavior_hint="")
"""For None, whose meaning the help text states: tyro would add "(default: None)"."""
Folder = Annotated[Path, tyro.conf.arg(metavar="DIR")]
MaybeFolder = Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")]
MaybeExperiment = Annotated[
    tyro.conf.Positional[Path | None],
    tyro.conf.arg(metavar="EXPERIMENT.toml", help_behavior_hint=""),
]
ModelFile = Annotated[
    Path | None, tyro.conf.arg(metavar="MODEL.toml", help_behavior_hint="(default: none)")
]
Seconds = Annotated[float | None, _read_by(_number, "S", "a number of seconds"), _DEFAULT_IN_HELP]
Range = Annotated[
    tuple[float, float] | None,
    _read_by(_numbers, "LOW HIGH", "two numbers", 2),
    _DEFAULT_IN_HELP,
]
Pressures = Annotated[
    tuple[float, ...] | None,
    _read_by(_numbers, "PA", "pressures in Pa, such as 250e3", "*"),
    _DEFAULT_IN_HELP,
]
Frequencies = Annotated[
    tuple[float, ...], _read_by(_numbers, "HZ ...", "frequencies in Hz, such as 1.5", "*")
]
_VALUE, _WHOLE = _read_by(_number, "X", "a number"), _read_by(_whole, "N", "a whole number")
Value = Annotated[float, _VALUE]
MaybeValue = Annotated[float | None, _VALUE, _DEFAULT_IN_HELP]
Whole = Annotated[int, _WHOLE]
MaybeWhole = Annotated[int | None, _WHOLE, _DEFAULT_IN_HELP]


def chosen_trials(trials: tuple, number: int | None) -> tuple:
    """All trials, or the one of `--trial`. Raises `InputError` if there is none such."""
    if number is None:
        return trials
    if not 0 <= number < len(trials):
        raise InputError.value("--trial", number, f"0 to {len(trials) - 1}")
    return trials[number : number + 1]


def refuse_own_folder(out: Path, folder: Path) -> None:
    """Raise `InputError` if results were to go where an experiment's measured files lie."""
    if out.resolve() == folder.resolve():
        raise InputError(f"--out {out}: is the experiment's own folder; give another")
