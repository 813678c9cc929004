"""Defines types of command-line arguments, and how help and error messages name the arguments."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tyro.constructors import PrimitiveConstructorSpec

from slider_jax.errors import InputError


def _read_by(
    read: Callable[[str], Any], metavar: str, allowed: str, count: int | Literal["*"] = 1
) -> PrimitiveConstructorSpec:
    """Returns a tyro type for an argument of `count` words, shown as `metavar` in the help.

    `read` converts a word. If `read` raises `ValueError`, the error message states `allowed`.
    """

    def instance(words: list[str]) -> Any:
        try:
            return read(words[0]) if count == 1 else tuple(map(read, words))
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


_DEFAULT_IN_HELP = tyro.conf.arg(help_behavior_hint="")
"""Removes tyro's "(default: None)" from the help of an option whose text states the default."""
Folder = Annotated[Path, tyro.conf.arg(metavar="DIR")]
MaybeFolder = Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")]
MaybeExperiment = Annotated[
    tyro.conf.Positional[Path | None],
    tyro.conf.arg(metavar="EXPERIMENT.toml", help_behavior_hint=""),
]
ModelFile = Annotated[
    Path | None, tyro.conf.arg(metavar="MODEL.toml", help_behavior_hint="(default: none)")
]
Seconds = Annotated[float | None, _read_by(float, "S", "a number of seconds"), _DEFAULT_IN_HELP]
Range = Annotated[
    tuple[float, float] | None, _read_by(float, "LOW HIGH", "two numbers", 2), _DEFAULT_IN_HELP
]
Pressures = Annotated[
    tuple[float, ...] | None,
    _read_by(float, "PA", "pressures in Pa, such as 250e3", "*"),
    _DEFAULT_IN_HELP,
]
Frequencies = Annotated[
    tuple[float, ...],
    _read_by(float, "HZ ...", "frequencies in Hz, such as 1.5", "*"),
    _DEFAULT_IN_HELP,
]
_VALUE, _WHOLE = _read_by(float, "X", "a number"), _read_by(int, "N", "a whole number")
Value = Annotated[float, _VALUE]
MaybeValue = Annotated[float | None, _VALUE, _DEFAULT_IN_HELP]
Whole = Annotated[int, _WHOLE]
MaybeWhole = Annotated[int | None, _WHOLE, _DEFAULT_IN_HELP]
EffectFiles = Annotated[
    tyro.conf.UseAppendAction[tuple[Path, ...]],
    tyro.conf.arg(
        metavar="FILE.py",
        help="Python file that defines effects of your own; repeat the option for more files "
        "(default: none). The file runs as Python code.",
        help_behavior_hint="",
    ),
]
Names = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...", help_behavior_hint="")]
Pictures = Annotated[bool, tyro.conf.arg(help_behavior_hint="(default: pictures are drawn)")]


def chosen_trials(trials: tuple, number: int | None) -> tuple:
    """Returns all trials, or only trial `number`. Raises `InputError` for an invalid number."""
    if number is None:
        return trials
    if not 0 <= number < len(trials):
        raise InputError.value("--trial", number, f"0 to {len(trials) - 1}")
    return trials[number : number + 1]


def refuse_own_folder(out: Path, folder: Path) -> None:
    """Raises `InputError` if results would overwrite an experiment's measured data."""
    if out.resolve() == folder.resolve():
        raise InputError(
            f"--out {out}: this is the experiment's own folder, whose files may be measured data; "
            "give another folder"
        )
