"""The recorder in a process of its own.

Beside a program that fills the disk, one command in a hundred was 30 to 43 ms late with the
recorder in the commands' own process, 14 ms with this, 7 to 19 ms without any. And the pieces of a
program that is killed are written to the last.
"""

import json
import os
import signal
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Mapping
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Any, BinaryIO

from rig.errors import RigError
from rig.recording.writer import MAX_WAITING, STREAMS, Recorder, RecorderLoad
from rig.scheduling import RECORDER_PRIORITY, ordinary_priority, real_time_priority

HAND_OVER = 0.02
"""Between what is handed to the process [s]; what a killed program can lose."""
PATIENCE = 60.0
"""Most time that it takes to start, and to write what waits at the end [s]."""
_HEAD = struct.Struct("<BqI")


class ProcessRecorder:
    """As `rig.recording.writer.Recorder`: a context manager with a sink for each stream.

    Raises `RigError` where that does, and in `check` and `close` if the process ended by itself.
    """

    def __init__(
        self,
        path: Path | str,
        streams: Iterable[str] = STREAMS,
        settings: Mapping[str, Any] | None = None,
        max_waiting: int = MAX_WAITING,
    ) -> None:
        self.path, self._names, self._most = Path(path), tuple(streams), max_waiting
        self._lock, self._waiting, self._size = threading.Lock(), list[bytes](), 0
        self._failure: RigError | None = None
        self._load: RecorderLoad | None = None
        self._told, self._closed = False, False
        self._started, self._ended = threading.Event(), threading.Event()
        self._ending = threading.Event()
        asked: dict[str, Any] = {
            "path": str(self.path),
            "streams": self._names,
            "settings": dict(settings or {}),
        }
        # A program of its own, not a fork or a spawn: those run the caller's main module again.
        with ordinary_priority() as asked["real_time"]:
            text = _as_json(path, asked)
            self._process = subprocess.Popen(
                [sys.executable, "-m", "rig.recording.writer_process"],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                env=os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
            )  # fmt: skip
        self._threads = [
            threading.Thread(target=work, name="recorder", daemon=True)
            for work in (self._listen, self._feed)
        ]
        self._threads[0].start()
        self._write(text.encode() + b"\n")
        if not self._started.wait(PATIENCE):
            self._fail(f"{self.path}: the recorder has not started in {PATIENCE:g} s")
        if self._failure is not None:
            self._end_process()
            raise self._failure
        self._threads[1].start()

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

    def load(self) -> RecorderLoad:
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
        if self._failure is not None and not self._told:
            self._told = True
            raise self._failure

    def close(self) -> None:
        """Everything to disk, and the process's end. Raises as `check`."""
        if not self._closed:
            self._closed = True
            self._ending.set()
            self._threads[1].join(PATIENCE)
            if not self._ended.wait(PATIENCE):
                self._fail(f"{self.path}: the recorder has not ended in {PATIENCE:g} s")
            self._end_process()
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
            self._write(b"".join(pieces))
        with suppress(OSError):
            assert self._process.stdin is not None
            self._process.stdin.close()

    def _write(self, content: bytes) -> None:
        """Nothing is raised: that the process has ended is heard by `_listen`."""
        assert self._process.stdin is not None
        with suppress(OSError, ValueError):
            self._process.stdin.write(content)
            self._process.stdin.flush()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            said = json.loads(line)
            if said["word"] == "started":
                self._started.set()
            elif said["word"] == "ended":
                self._load = RecorderLoad(**said["content"])
                self._ended.set()
            else:
                self._fail(said["content"])
        if not self._ended.is_set():
            self._fail(
                f"{self.path}: the recorder's process has ended by itself; what it wrote is kept"
            )
        self._started.set()
        self._ended.set()

    def _fail(self, text: str) -> None:
        if self._failure is None:
            self._failure = RigError(text)

    def _end_process(self) -> None:
        assert self._process.stdin is not None and self._process.stdout is not None
        if not self._ended.is_set():
            self._process.kill()
        with suppress(OSError):
            self._process.stdin.close()
        self._process.wait()
        self._threads[0].join()
        self._process.stdout.close()


def _as_json(path: Path | str, asked: Mapping[str, Any]) -> str:
    try:
        return json.dumps(asked, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise RigError(f"recording {path}: settings are not JSON ({error})") from None


def write_from_stdin() -> None:
    """What the process does: a line of JSON, then pieces until the end of the standard input."""
    # These are for the program: it tells when to end.
    for name in ("SIGINT", "SIGHUP", "SIGTERM"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    lock = threading.Lock()

    def say(word: str, content: Any = None) -> None:
        with lock, suppress(OSError):
            print(json.dumps({"word": word, "content": content}), flush=True)

    source = sys.stdin.buffer
    asked = json.loads(source.readline())
    with real_time_priority(RECORDER_PRIORITY) if asked["real_time"] else nullcontext():
        _record(asked, source, say)


def _record(asked: Mapping[str, Any], source: BinaryIO, say: Callable[..., None]) -> None:
    try:
        recorder = Recorder(
            asked["path"], asked["streams"], asked["settings"],
            lambda failure: say("failed", str(failure)),
        )  # fmt: skip
    except RigError as refusal:
        say("refused", str(refusal))
        return
    say("started")
    sinks = [recorder.sink(name) for name in asked["streams"]]
    while len(head := source.read(_HEAD.size)) == _HEAD.size:
        number, host_ns, size = _HEAD.unpack(head)
        piece = source.read(size)
        if len(piece) == size:
            sinks[number](host_ns, piece)
    with suppress(RigError):  # said when it came
        recorder.close()
    say("ended", recorder.load()._asdict())


if __name__ == "__main__":
    write_from_stdin()
