"""Simulates the published firmware: its dialogue with the host, and pressure tests."""

import re
from collections.abc import Callable, Iterator
from math import pi, sin

from rig.protocol.published import COLUMNS, PA_PER_PSI, PSI_AT_ZERO, PSI_PER_COUNT

PERIOD_US = 2_000
MIDDLE, AMPLITUDE = 291.0, 200.0
"""Mean and amplitude of the commanded sine [counts] in all published logs."""
ASK_US = 1_000_000
"""Interval of the question for a frequency [us]. A host that connects discards earlier
questions."""
PAUSE_US = 200_000
"""Time from the end of a test to the next question [us]."""
TYPED_US = 1_000_000
"""A number without a line end is complete after this time [us], as for Arduino's `parseFloat`."""

Script = Iterator[tuple[int, bytes]]
"""Pieces of text to send, each with its time of sending after the host's answer [us]."""
Plant = Callable[[int, int, float], float]
"""Function of fill duty, vent duty (0 to 255) and duration [s] that returns gauge pressure [Pa]."""


class PublishedFirmware:
    """A device that repeatedly asks for a frequency and runs a test.

    `test` is called with the frequency [Hz] and the device's time [us], and returns the text to
    send. As in the original firmware, input that arrives during a test answers the next question.
    """

    def __init__(
        self, test: Callable[[float, int], Script], question: bytes = b"Enter frequency in Hz: "
    ):
        self._test, self._question = test, question
        self._typed, self._typed_at, self._ask_at = b"", 0, 0
        self._script: Script | None = None
        self._next: tuple[int, bytes] | None = None
        self._start = 0

    def feed(self, piece: bytes, now_us: int) -> bytes:
        """Takes bytes from the host. A later call of `tick` returns the answer."""
        self._typed += piece
        self._typed_at = now_us
        return b""

    def tick(self, now_us: int) -> bytes:
        """Returns the bytes sent up to `now_us`."""
        if self._script is None:
            frequency = self._answer(now_us)
            if frequency is None:
                if now_us < self._ask_at:
                    return b""
                self._ask_at = now_us + ASK_US
                return self._question
            self._script, self._start = self._test(frequency, now_us), now_us
            self._next = next(self._script, None)
        sent = []
        while self._next is not None and self._start + self._next[0] <= now_us:
            sent.append(self._next[1])
            self._next = next(self._script, None)
        if self._next is None:
            self._script, self._ask_at = None, now_us + PAUSE_US
        return b"".join(sent)

    def _answer(self, now_us: int) -> float | None:
        line, end, rest = self._typed.replace(b"\r", b"\n").partition(b"\n")
        if not end and (not line or now_us - self._typed_at < TYPED_US):
            return None
        self._typed = rest
        number = re.search(rb"\d+(\.\d*)?", line)
        return float(number[0]) if number else None


def replay_log(log: bytes, period_us: int = PERIOD_US) -> Callable[[float, int], Script]:
    """Returns a test that sends an unchanged log, one row every `period_us` [us] (0: all at once).

    The test ignores the frequency that the host sends, so the host should send that of the log.
    """

    def test(frequency: float, now_us: int) -> Script:
        due = 0
        for line in re.findall(rb"[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+", log):
            if line[:1].isdigit():
                due += period_us
            yield due, line

    return test


def simulate_frequency_test(plant: Plant, cycles: int = 10) -> Callable[[float, int], Script]:
    """Returns a test of `plant` with the firmware's sine and control law, a row per `PERIOD_US`.

    The duty is min(250, 10 |error|) with the error in counts. Until the next row, this duty applies
    to the fill valve if the error is positive, otherwise to the vent valve.
    """

    def test(frequency: float, now_us: int) -> Script:
        samples = round(cycles * 1e6 / (frequency * PERIOD_US))
        start = now_us // 1000
        head = (
            "-----NEW TEST-------",
            f"frequency:    {frequency:.6f} Hz",
            f"start time    {start} ms",
            f"stop time     {start + samples * PERIOD_US // 1000} ms",
            f"Sample Prd    {PERIOD_US // 1000} ms",
            f"Number Cylces {cycles} ",
            COLUMNS,
        )
        for line in head:
            yield 0, f"{line}\r".encode()
        fill = vent = 0
        for number in range(1, samples + 1):
            t = number * PERIOD_US * 1e-6
            measured = (plant(fill, vent, PERIOD_US * 1e-6) / PA_PER_PSI - PSI_AT_ZERO) / (
                PSI_PER_COUNT
            )
            pressure = min(max(round(measured), 0), 4095)
            command = round(MIDDLE + AMPLITUDE * sin(2.0 * pi * frequency * t), 2)
            error = command - pressure
            duty = int(min(250.0, 10.0 * abs(error)))
            fill, vent = (duty, 0) if error > 0.0 else (0, duty)
            row = f"{number},{fill},{vent},{command:.2f},{error:.2f},{pressure}\r"
            yield number * PERIOD_US, row.encode()
        yield samples * PERIOD_US, f"done{len(head) + samples}\r".encode()

    return test
