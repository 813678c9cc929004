"""The two errors that a user can meet, each one message that says what to do next."""

from collections.abc import Iterable
from difflib import get_close_matches


class InputError(Exception):
    """What was given cannot be used. The command line prints the message and exits with 2."""

    @classmethod
    def value(cls, where: str, given: object, allowed: str, advice: str = "") -> "InputError":
        """The message for one bad value: `where` is a field's path, or a file and line."""
        message = f"{where}: given {given}; allowed {allowed}"
        return cls(f"{message}; {advice}" if advice else message)


class SolverError(Exception):
    """A single run's time step did not converge. Batches carry this as a value instead."""


def did_you_mean(given: str, allowed: Iterable[str]) -> str:
    """What a message adds of the allowed name that a mistyped one is nearest to, if any is near."""
    close = get_close_matches(given, list(allowed), 1)
    return f"; did you mean {close[0]}?" if close else ""
