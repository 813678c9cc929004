"""How far a command has come: a bar on a terminal, plain lines on any other stderr."""

import sys
import threading
import time
from collections.abc import Callable
from types import TracebackType

from tqdm import tqdm

PATIENCE = 2.0
"""After so many seconds without a first report, what is done meanwhile is said [s]."""
PAUSE = 10.0
"""Between two lines [s]."""


class Progress:
    """A context that is told what is done, from any thread. Nothing is left of a bar at its end."""

    def __init__(self, name: str, unit: str, first: str = "compiling"):
        self._name, self._unit = name, unit
        self._lock, self._done, self._total = threading.Lock(), 0, 0
        self._bar = tqdm(desc=f"{name}: {first}", unit=unit, leave=False, disable=None)
        self._next = time.monotonic() + PAUSE
        self._waiting = threading.Timer(PATIENCE, self._say, (f"{name}: {first} ...",))
        self._waiting.daemon = True

    def __enter__(self) -> "Progress":
        if self._bar.disable:
            self._waiting.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._waiting.cancel()
        self._bar.close()

    def begin(self, total: int, done: int = 0) -> None:
        """There is `total` to do, of which some was `done` before; the first is still to come."""
        self._total, self._done = total, done
        self._bar.total = total
        self._bar.update(done)

    def step(self) -> None:
        """One more is done."""
        with self._lock:
            self._to(self._done + 1, self._total)

    def to(self, done: int, total: int) -> None:
        """`done` of `total` are done."""
        with self._lock:
            self._to(done, total)

    def _to(self, done: int, total: int) -> None:
        self._waiting.cancel()
        if not self._bar.disable:
            self._bar.set_description(self._name, refresh=False)
            self._bar.total = total
            self._bar.update(done - self._done)
        elif time.monotonic() >= self._next and done < total:
            self._say(f"{self._name}: {done} of {total} {self._unit}s")
            self._next = time.monotonic() + PAUSE
        self._done = done

    @staticmethod
    def _say(line: str) -> None:
        print(line, file=sys.stderr, flush=True)


def timed_printer() -> Callable[[str], None]:
    """Return a function that prints a text to stderr, after the seconds since this call."""
    start = time.monotonic()

    def print_timed(text: str) -> None:
        print(f"{time.monotonic() - start:5.0f} s  {text}", file=sys.stderr, flush=True)

    return print_timed
