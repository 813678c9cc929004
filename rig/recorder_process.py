"""The recorder in a process of its own.

Beside a program that fills the disk, one command in a hundred was 30 to 43 ms late with the
recorder in the commands' own process, 14 ms with this, 7 to 19 ms without any. And the pieces of a
program that is killed are written to the last.
"""

import multiprocessing
import os
import signal
import struct
import threading
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from rig.errors import RigError
from rig.recorder import MOST_WAITING, STREAMS, Load, Recorder

HAND_OVER = 0.02
"""Between what is handed to the process [s]; what a killed program can lose."""
PATIENCE = 60.0
"""Most time that it takes to start, and to write what waits at the end [s]."""
_HEAD = struct.Struct("<BqI")


class ProcessRecorder:
    """As `rig.recorder.Recorder`: a context manager with a sink for each stream.

    Raises `RigError` where that does, and in `check` and `close` if the process ended by itself.
    """

    def __init__(
        self,
        path: Path | str,
        streams: Iterable[str] = STREAMS,
        settings: Mapping[str, Any] | None = None,
        most_waiting: int = MOST_WAITING,
    ) -> None:
        self.path, self._names, self._most = Path(path), tuple(streams), most_waiting
        self._lock, self._waiting, self._size = threading.Lock(), list[bytes](), 0
        self._failure: RigError | None = None
        self._load: Load | None = None
        self._told = False
        context = multiprocessing.get_context("spawn")
        self._line, theirs = context.Pipe()
        self._process = context.Process(
            target=_record, name="recorder", daemon=True,
            args=(theirs, self.path, self._names, dict(settings or {})),
        )  # fmt: skip
        self._process.start()
        theirs.close()
        self._await("started")
        if self._failure is not None:
            self._line.close()
            self._process.join()
            raise self._failure
        self._ending = threading.Event()
        self._feeder = threading.Thread(target=self._feed, name="to the recorder", daemon=True)
        self._feeder.start()

    @property
    def pid(self) -> int | None:
        """Of the process."""
        return self._process.pid

    def sink(self, stream: str) -> Callable[[int, bytes], None]:
        """`sink(host_ns, piece)` records a piece; any thread may call it, and it never waits."""
        if stream not in self._names:
            raise RigError.value("stream", repr(stream), ", ".join(self._names))
        number = self._names.index(stream)

        def put(host_ns: int, piece: bytes) -> None:
            with self._lock:
                self._waiting += (_HEAD.pack(number, host_ns, len(piece)), piece)
                self._size += len(piece)

        return put

    def load(self) -> Load:
        """How it kept up; once it is closed."""
        assert self._load is not None
        return self._load

    def check(self) -> None:
        """Raises what went wrong, once."""
        if self._size > self._most and self._failure is None:
            self._failure = RigError(
                f"{self.path}: the disk is too slow, {self._size >> 20} MiB wait for it; record to "
                "another one"
            )
        with suppress(EOFError, OSError):
            while self._line.poll():
                self._hear(self._line.recv())
        if self._failure is not None and not self._told:
            self._told = True
            raise self._failure

    def close(self) -> None:
        """Everything to disk, and the process's end. Raises as `check`."""
        if not self._ending.is_set():
            self._ending.set()
            self._feeder.join()
            self._await("ended")
            self._line.close()
            self._process.join()
        if self._failure is not None and not self._told:
            self._told = True
            raise self._failure

    def __enter__(self) -> "ProcessRecorder":
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        try:
            self.close()
        except RigError as failure:
            if error is None:
                raise
            error.add_note(str(failure))

    def _feed(self) -> None:
        ends = False
        while not ends:
            ends = self._ending.wait(HAND_OVER)
            with self._lock:
                pieces, self._waiting, self._size = self._waiting, [], 0
            try:
                if pieces:
                    self._line.send_bytes(b"".join(pieces))
                if ends:
                    self._line.send_bytes(b"")
            except OSError:
                self._lost()
                return

    def _await(self, word: str) -> None:
        """Until the process says so, or fails."""
        try:
            while self._line.poll(PATIENCE):
                said = self._line.recv()
                self._hear(said)
                if said[0] in (word, "refused"):
                    return
            self._failure = RigError(f"{self.path}: the recorder has not {word} in {PATIENCE:g} s")
        except (EOFError, OSError):
            self._lost()

    def _hear(self, said: tuple[str, Any]) -> None:
        word, content = said
        if word == "ended":
            self._load = content
        elif word in ("failed", "refused"):
            self._failure = RigError(content)

    def _lost(self) -> None:
        if self._failure is None:
            self._failure = RigError(
                f"{self.path}: the recorder's process has ended by itself; what it wrote is kept"
            )


def _record(line: Connection, path: Path, streams: tuple[str, ...], settings: Any) -> None:
    """What the process does."""
    # Ctrl-C and a closed terminal are for the program: it tells when to end.
    for name in ("SIGINT", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    if hasattr(os, "sched_setscheduler"):
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    lock = threading.Lock()

    def say(word: str, content: Any = None) -> None:
        with lock, suppress(OSError):
            line.send((word, content))

    try:
        recorder = Recorder(path, streams, settings, lambda failure: say("failed", str(failure)))
    except RigError as refusal:
        say("refused", str(refusal))
        return
    say("started")
    sinks = [recorder.sink(name) for name in streams]
    with suppress(EOFError, OSError):
        while batch := line.recv_bytes():
            _sort(batch, sinks)
    with suppress(RigError):  # said when it came
        recorder.close()
    say("ended", recorder.load())


def _sort(batch: bytes, sinks: list[Callable[[int, bytes], None]]) -> None:
    at = 0
    while at < len(batch):
        number, host_ns, size = _HEAD.unpack_from(batch, at)
        at += _HEAD.size
        sinks[number](host_ns, batch[at : at + size])
        at += size
