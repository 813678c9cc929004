"""Divides work among processes that share a folder, on one computer or on many.

A job is the computation of one result file. A process claims a job before it computes the result:
it creates the file `NAME.claim0`, which succeeds in only one process. The result is written under a
temporary name and then renamed. While the process runs, it renews the times of its claims. A claim
is void if its process does not exist any more on this computer, or if the claim is not renewed for
`CLAIM_LIFETIME`. The process that creates `NAME.claim1` then takes the job over, and so on. Each
process measures the time with its own clock, so the clocks of the computers need not agree.
"""

import os
import platform
import threading
import time
import zlib
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import cache
from pathlib import Path

from slider_jax.io.files import write_bytes

RENEWED = 10.0
"""Time [s] between two renewals of a claim."""
CLAIM_LIFETIME = 60.0
"""Time [s] after which a claim that is not renewed is void. A network file system may show a
renewal up to 30 s late."""
PAUSE = 0.2
"""Time [s] between two checks of the results of other processes."""


class SharedFolder:
    """Context manager for the jobs of one process in `folder`, whose results have unique names.

    Any thread may call the methods. At the end of the context, unfinished jobs are given up.
    """

    def __init__(self, folder: Path):
        self.folder = folder
        self._mine: dict[str, Path] = {}
        self._seen: dict[str, tuple[float, float]] = {}
        self._lock, self._stopped = threading.Lock(), threading.Event()
        self._renewer = threading.Thread(target=self._renew, daemon=True)

    def __enter__(self) -> "SharedFolder":
        self.folder.mkdir(parents=True, exist_ok=True)
        self._renewer.start()
        return self

    def __exit__(self, *failure: object) -> None:
        self._stopped.set()
        self._renewer.join()
        for name in list(self._mine):
            self.give_up(name)

    def _renew(self) -> None:
        while not self._stopped.wait(RENEWED):
            with self._lock:
                claims = list(self._mine.values())
            for claim in claims:
                with suppress(OSError):  # the folder was removed
                    os.utime(claim)

    def is_done(self, name: str) -> bool:
        """Returns whether the result `name` exists."""
        return (self.folder / name).exists()

    def take(self, name: str) -> bool:
        """Claims a job. Returns False if its result exists, or if another process computes it."""
        if self.is_done(name):
            return False
        claims = self.folder.glob(f"{name}.claim*")
        number = max((int(x.suffix.removeprefix(".claim")) for x in claims), default=-1) + 1
        if number and not self._is_void(self.folder / f"{name}.claim{number - 1}"):
            return False
        claim = self.folder / f"{name}.claim{number}"
        try:
            handle = os.open(claim, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o644)
        except FileExistsError:
            return False
        with os.fdopen(handle, "w") as file:
            file.write(f"{_computer()} {os.getpid()}\n")
        with self._lock:
            self._mine[name] = claim
        if self.is_done(name):  # its process finished and removed its claim meanwhile
            self.give_up(name)
            return False
        return True

    def _is_void(self, claim: Path) -> bool:
        try:
            renewed, owner = claim.stat().st_mtime, claim.read_text().split()
        except OSError:  # its process finished or gave up the job meanwhile
            return False
        if len(owner) == 2 and owner[0] == _computer() and not _exists(int(owner[1])):
            return True
        now = time.monotonic()
        last, since = self._seen.get(claim.name, (renewed, now))
        self._seen[claim.name] = (renewed, now if renewed != last else since)
        return renewed == last and now - since > CLAIM_LIFETIME

    def give_up(self, name: str) -> None:
        """Removes the claim of this process to a job."""
        with self._lock:
            claim = self._mine.pop(name)
        claim.unlink(missing_ok=True)

    def finish(self, name: str, result: bytes) -> None:
        """Writes the result of a job of this process, and removes all claims to the job."""
        write_bytes(self.folder / name, result)
        last = self._mine[name]
        for number in range(int(last.name.removeprefix(f"{name}.claim"))):
            (self.folder / f"{name}.claim{number}").unlink(missing_ok=True)
        self.give_up(name)

    def compute(self, names: Iterable[str], work: Callable[[str], bytes]) -> None:
        """Returns when all results exist; `work(name)` computes those of the jobs that it takes."""
        pending = list(names)
        first = zlib.crc32(f"{_computer()} {os.getpid()}".encode()) % max(1, len(pending))
        pending = pending[first:] + pending[:first]  # fewer processes try the same job
        while True:
            there = set(os.listdir(self.folder))  # one request for all jobs
            pending = [name for name in pending if name not in there]
            free = [name for name in pending if f"{name}.claim0" not in there]
            if not pending:
                return
            if not any(self._computed(x, work) for x in free[:1] or pending):
                time.sleep(PAUSE)

    def alone(self, name: str, is_done: Callable[[], bool], work: Callable[[], object]) -> None:
        """Returns when `is_done()` is true; one process calls `work()`, which makes it true."""
        while not is_done():
            if self.take(name):
                if not is_done():  # another process may have finished before the claim
                    work()
                self.give_up(name)
                return
            time.sleep(PAUSE)

    def _computed(self, name: str, work: Callable[[str], bytes]) -> bool:
        if not self.take(name):
            return False
        self.finish(name, work(name))
        return True


@cache
def _computer() -> str:
    """Returns a name of this computer, since its start and for its own numbers of processes."""
    parts = [platform.node()]
    with suppress(OSError):  # not on Linux
        parts.append(Path("/proc/sys/kernel/random/boot_id").read_text().strip())
        parts.append(os.readlink("/proc/self/ns/pid"))
    return "-".join(parts)


def _exists(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # of another user
        return True
    return True
