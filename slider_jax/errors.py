"""Defines the two exceptions for users. Each message says what the user can do next."""

from collections.abc import Iterable
from difflib import get_close_matches


class InputError(Exception):
    """An invalid input. The command line prints the message and exits with status 2."""

    @classmethod
    def value(cls, where: str, given: object, allowed: str, advice: str = "") -> "InputError":
        """Returns the error for an invalid value. `where` names the field, or the file and line."""
        message = f"{where}: given {given}; allowed {allowed}"
        return cls(f"{message}; {advice}" if advice else message)


class SolverError(Exception):
    """A time step of a single run did not converge. Functions for batches return a flag instead."""


def did_you_mean(given: str, allowed: Iterable[str]) -> str:
    """Returns a clause that suggests the allowed name closest to `given`; "" if none is close."""
    close = get_close_matches(given, list(allowed), 1)
    return f"; did you mean {close[0]}?" if close else ""


def refuse_unknown(
    where: str, names: Iterable[str], allowed: Iterable[str], listed: str = ""
) -> None:
    """Raises `InputError` for the first of `names` that is not in `allowed`.

    `listed` describes the allowed names in the message (default: a list of all allowed names).
    """
    known = list(allowed)
    for name in names:
        if name not in known:
            near = did_you_mean(name, known)
            raise InputError.value(where, repr(name), (listed or ", ".join(known)) + near)
