"""Shows the progress of a command: a bar on a terminal, otherwise lines on stderr."""

import sys
import threading
import time
from collections.abc import Callable

from tqdm import tqdm

PATIENCE = 2.0
"""Time [s] without progress after which a line with the current activity is printed."""
PAUSE = 10.0
"""Shortest time [s] between two printed lines."""


class Progress:
    """Context manager that shows a progress bar. Any thread may call `step` and `to`."""

    def __init__(self, name: str, unit: str, first: str = "compiling"):
        self._name, self._unit = name, unit
        self._lock, self._done, self._total = threading.RLock(), 0, 0
        self._bar = tqdm(desc=f"{name}: {first}", unit=unit, leave=False, disable=None)
        self._next = time.monotonic() + PAUSE
        self._waiting = threading.Timer(PATIENCE, self._print, (f"{name}: {first} ...",))
        self._waiting.daemon = True

    def __enter__(self) -> "Progress":
        if self._bar.disable:
            self._waiting.start()
        return self

    def __exit__(self, *failure: object) -> None:
        self._waiting.cancel()
        self._bar.close()

    def begin(self, total: int, done: int = 0) -> None:
        """Sets the total number of steps, of which `done` were completed in an earlier run."""
        self._total, self._done = total, done
        self._bar.total = total
        self._bar.update(done)

    def step(self) -> None:
        """Reports one completed step."""
        with self._lock:
            self.to(self._done + 1, self._total)

    def to(self, done: int, total: int) -> None:
        """Reports that `done` of `total` steps are complete."""
        with self._lock:
            self._waiting.cancel()
            if not self._bar.disable:
                self._bar.set_description(self._name, refresh=False)
                self._bar.total = total
                self._bar.update(done - self._done)
            elif time.monotonic() >= self._next and done < total:
                self._print(f"{self._name}: {done} of {total} {self._unit}s")
                self._next = time.monotonic() + PAUSE
            self._done = done

    @staticmethod
    def _print(line: str) -> None:
        print(line, file=sys.stderr, flush=True)


def timed_printer() -> Callable[[str], None]:
    """Returns a function that prints a text to stderr, preceded by the elapsed time in seconds."""
    start = time.monotonic()

    def print_timed(text: str) -> None:
        print(f"{time.monotonic() - start:5.0f} s  {text}", file=sys.stderr, flush=True)

    return print_timed
