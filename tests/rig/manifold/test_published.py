"""The published firmware's dialogue: parser, driver, and a simulation from real logs."""

import math
import random
import re
import time

import numpy as np
import pytest

from calibration.pressure_logs.read import PA_PER_PSI, psi, read_log
from calibration.pressure_logs.synthetic import COUNT, PERIOD, Valves
from rig.errors import RigError
from rig.manifold.published import PublishedManifold
from rig.manifold.serial_port import PortLost, open_port
from rig.protocol.published import Dialogue, Done, Header, LogRow, Question, counts_to_pascal
from rig.simulated.published import PublishedFirmware, replay_log, simulate_frequency_test
from rig.simulated.terminal import BACKLOG, serve_in_process, serve_in_thread
from tests.support.synthetic_log import log_lines

REAL = (
    "0.25", "0.55556", "0.86111", "1.1667", "1.4722", "1.7778", "2.0833", "2.3889", "2.6944", "3"
)  # fmt: skip
STALE = "1,0,250,406.25,-27.75,434"


def make_log(end="\r", last_end=True, stale=False, frequency=2.0, cycles=2.0):
    """Returns a small log as bytes."""
    lines = log_lines(frequency=frequency, cycles=cycles)
    text = end.join([STALE, *lines[:-1], f"done{len(lines)}"] if stale else lines)
    return (text + end * last_end).encode()


def naive_rows(log):
    """Returns the rows after the column names, by plain splitting."""
    body = re.split(r"[\r\n]+", log.decode().partition("pressure\r")[2] or log.decode())
    rows = [line.split(",") for line in body if re.match(r"\d+,", line)]
    return [(int(a), int(b), int(c), float(d), float(e), int(f)) for a, b, c, d, e, f in rows]


class VirtualPort:
    """A port with a device, in virtual time: a read without data takes a millisecond."""

    name = "virtual port"

    def __init__(self, device, pieces=lambda: 4096):
        self.device, self.pieces = device, pieces
        self.now_us, self.sent, self.arriving, self.open = 0, b"", b"", True

    @property
    def in_waiting(self):
        self.arriving += self.device.tick(self.now_us)
        return len(self.arriving)

    def read(self, size):
        if not self.arriving:
            self.now_us += 1000
            self.arriving = self.device.tick(self.now_us)
        size = min(size, self.pieces()) if self.arriving else 0
        piece, self.arriving = self.arriving[:size], self.arriving[size:]
        return piece

    def write(self, piece):
        self.sent += piece
        self.arriving += self.device.feed(piece, self.now_us)

    def close(self):
        self.open = False

    def ns(self):
        return 1000 * self.now_us


class ScriptedDevice:
    """A device that sends the given (time [us], bytes) pairs in order and ignores its input."""

    def __init__(self, *script):
        self.script = list(script)

    def feed(self, piece, now_us):
        return b""

    def tick(self, now_us):
        return self.script.pop(0)[1] if self.script and self.script[0][0] <= now_us else b""


def record(port, frequency, **keywords):
    """Runs a test; returns its outcome, its bytes and its (time [ns], row) pairs."""
    pieces, rows = [], []
    manifold = PublishedManifold(port, **keywords)
    outcome = manifold.run_test(
        frequency, lambda at, row: rows.append((at, row)), lambda at, piece: pieces.append(piece)
    )
    return outcome, b"".join(pieces), rows


def record_in_virtual_time(log, frequency, pieces=lambda: 4096, **keywords):
    port = VirtualPort(PublishedFirmware(replay_log(log, **keywords)), pieces)
    return record(port, frequency, clock=port.ns)


def assert_same_log(tmp_path, recorded, log):
    """Asserts that `read_log` reads the same from both."""
    paths = tmp_path / "recorded.txt", tmp_path / "log.txt"
    for path, content in zip(paths, (recorded, log), strict=True):
        path.write_bytes(content)
    a, b = map(read_log, paths)
    for name in ("t", "command", "pressure", "fill", "vent"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    assert (a.frequency, a.period, a.findings) == (b.frequency, b.period, b.findings)


@pytest.mark.parametrize("name", REAL)
def test_the_recording_of_a_replayed_real_log_equals_it_byte_for_byte(data, tmp_path, name):
    log = (data / "manifold" / f"{name}.txt").read_bytes()
    frequency = float(re.search(rb"frequency:\s+([\d.]+)", log)[1])
    chance = random.Random(0)
    outcome, recorded, rows = record_in_virtual_time(log, frequency, lambda: chance.randint(1, 40))
    assert recorded == log
    assert [tuple(row) for _, row in rows] == naive_rows(log)
    assert (outcome.damaged, outcome.lost, outcome.rows) == (0, 0, len(rows))
    assert outcome.stale == (name in ("1.1667", "2.3889"))
    assert_same_log(tmp_path, recorded, log)


@pytest.mark.parametrize("end", ["\r", "\n", "\r\n"])
@pytest.mark.parametrize("last_end", [True, False])
@pytest.mark.parametrize("size", [1, 7, 4096])
def test_the_log_is_recorded_unchanged_for_every_line_end_and_piece_size(
    tmp_path, end, last_end, size
):
    log = make_log(end, last_end, stale=size == 7)
    outcome, recorded, rows = record_in_virtual_time(log, 2.0, lambda: size)
    assert recorded == log
    assert [tuple(row) for _, row in rows] == naive_rows(make_log())
    assert outcome.header == Header(2.0, 1.0, 2.0, 0.002, 2.0)
    assert (
        outcome.lines
        == outcome.counted
        == len(log_lines(frequency=2.0, cycles=2.0)) - 1 + (size == 7)
    )
    assert outcome.findings == (
        ("1 rows of an earlier test arrived before the header",) if size == 7 else ()
    )
    assert_same_log(tmp_path, recorded, log)


def test_rows_are_reported_when_they_are_sent():
    _, _, rows = record_in_virtual_time(make_log(), 2.0)
    steps = np.diff([at for at, _ in rows])
    np.testing.assert_allclose(steps, 2e6, atol=1e6)


def test_several_tests_run_on_one_port():
    log = make_log()
    port = VirtualPort(PublishedFirmware(replay_log(log)))
    manifold = PublishedManifold(port, clock=port.ns)
    for _ in range(3):
        pieces = []
        manifold.run_test(2.0, sink=lambda at, piece, pieces=pieces: pieces.append(piece))
        assert b"".join(pieces) == log
    assert port.sent == 3 * b"2.000000\n"
    assert port.open


def test_a_log_from_a_terminal_in_another_process_is_recorded_byte_for_byte(tmp_path):
    log = make_log(frequency=5.0, cycles=4.0)
    with serve_in_process(_replaying_firmware, log, 500) as served:
        port = open_port(served.path)
        outcome, recorded, rows = record(port, 5.0)
        assert recorded == log
        assert len(rows) == outcome.rows == 400
        assert_same_log(tmp_path, recorded, log)
        served.unplug()
        with pytest.raises(PortLost, match="gone"):
            record(port, 5.0)
    assert not port.is_open


@pytest.mark.slow
def test_all_real_logs_from_a_terminal_are_recorded_byte_for_byte(data):
    for name in REAL:
        log = (data / "manifold" / f"{name}.txt").read_bytes()
        frequency = float(re.search(rb"frequency:\s+([\d.]+)", log)[1])
        with serve_in_process(_replaying_firmware, log, 100, backlog=2**20) as served:
            port = open_port(served.path)
            outcome, recorded, _ = record(port, frequency)
            port.close()
        assert recorded == log, name
        assert (outcome.damaged, outcome.lost) == (0, 0)


def _replaying_firmware(log, period_us):
    return PublishedFirmware(replay_log(log, period_us))


def _failing_device():
    raise SystemExit(1)


def test_a_device_that_does_not_start_is_an_error():
    with pytest.raises(RigError, match="did not start"):
        with serve_in_process(_failing_device):
            pass


def parse(dialogue, *pieces):
    return [event for piece in pieces for event in dialogue.feed(piece)]


def test_a_row_with_a_lost_byte_is_counted_and_not_accepted():
    log, chance = make_log(), random.Random(1)
    expected = {row[0]: row for row in naive_rows(log)}
    head = log.index(b"\r1,") + 1
    for _ in range(150):
        at = chance.randrange(head, len(log) - 8)
        dialogue = Dialogue()
        dialogue.answered()
        events = parse(dialogue, log[:at] + log[at + 1 :])
        rows = [event for event in events if isinstance(event, LogRow)]
        # A row has no checksum of the valves' duties.
        assert all(
            tuple(r[:1] + r[3:]) == expected[r.number][:1] + expected[r.number][3:] for r in rows
        )
        assert dialogue.rows == len(rows) >= len(expected) - 2
        duties_damaged = rows != [LogRow(*row) for row in expected.values()] and len(rows) == len(
            expected
        )
        assert duties_damaged or dialogue.damaged == 1
        ends = (1, len(expected))
        assert dialogue.lost == sum(ends[0] < n < ends[1] for n in expected.keys() - {*(
            r.number for r in rows)})  # fmt: skip


def test_a_number_with_an_added_digit_loses_only_its_row():
    log = make_log().replace(b"\r100,", b"\r9100,")
    outcome, _, rows = record_in_virtual_time(log, 2.0)
    assert (outcome.damaged, outcome.lost) == (1, 1)
    assert [row.number for _, row in rows] == [n for n in range(1, 501) if n != 100]


def test_rows_are_accepted_after_a_long_gap():
    lines = make_log().split(b"\r")
    outcome, _, rows = record_in_virtual_time(b"\r".join(lines[:100] + lines[300:]), 2.0)
    # The first row after the gap must be confirmed by the next, so it is lost too.
    assert outcome.lost == 201
    assert outcome.findings[-1] == "the firmware counted 507 lines, 307 arrived"
    assert rows[-1][1].number == 500


def test_a_damaged_line_of_column_names_loses_no_row():
    log = make_log().replace(b"pressureError", b"pressurError")
    outcome, _, rows = record_in_virtual_time(log, 2.0)
    assert len(rows) == 500
    assert (outcome.damaged, outcome.header.frequency) == (1, 2.0)


def test_noise_without_a_line_end_is_dropped_and_counted():
    dialogue = Dialogue()
    dialogue.answered()
    parse(dialogue, *[b"\xfe" * 100] * 60)
    assert dialogue.damaged == 10
    assert len(dialogue.unparsed) <= 512


def test_a_question_is_recognised_by_the_silence_after_it():
    dialogue = Dialogue()
    assert parse(dialogue, b"Sensor ok\r\nEnter freq", b"uency: ") == []
    assert dialogue.quiet() == [Question("Enter frequency:")]
    assert parse(dialogue, b"\r\n> ") == []
    assert dialogue.quiet() == [Question("Enter frequency:")]
    dialogue.answered()
    assert dialogue.quiet() == []


def test_the_header_of_a_running_test_is_not_a_question():
    dialogue = Dialogue()
    parse(dialogue, b"frequency:    0.250000 Hz\r")
    assert dialogue.quiet() == []
    parse(dialogue, b"Frequency?\r" + STALE.encode() + b"\r")
    assert dialogue.quiet() == []


def test_bytes_after_done_are_kept_for_the_next_test():
    dialogue = Dialogue()
    dialogue.answered()
    assert parse(dialogue, b"done12\r") == []
    assert parse(dialogue, b"\nFrequency") == [Done(12)]
    assert dialogue.unparsed == b"Frequency"


def test_counts_are_converted_as_in_the_reader_of_logs():
    assert counts_to_pascal(300.0) == pytest.approx(PA_PER_PSI * psi(300.0))
    row = LogRow(1, 0, 250, 91.02, -197.98, 289)
    assert row.pressure_Pa == counts_to_pascal(289)
    assert row.command_Pa == counts_to_pascal(91.02)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -1.0, 0.0, 0.05, 50.0])
def test_a_frequency_that_is_not_allowed_is_never_sent(bad):
    port = VirtualPort(PublishedFirmware(replay_log(make_log())))
    with pytest.raises(RigError, match=r"frequency: given .* Hz; allowed 0\.1 to 5 Hz"):
        record(port, bad, clock=port.ns)
    assert port.sent == b""


ROW = b"7,0,250,406.25,-27.75,434\r"
HEAD = make_log()[: make_log().index(b"\r1,") + 1]


@pytest.mark.parametrize(
    ("device", "message"),
    [
        (
            ScriptedDevice(),
            "no question for a frequency in 5 s; received nothing; .*reset the board",
        ),
        (ScriptedDevice((0, b"Hello\r\n")), "received 'Hello'"),
        (
            ScriptedDevice((0, bytes(range(130, 250)) + b"\r")),
            "received bytes that are not text; .*rig check",
        ),
        (
            ScriptedDevice(*[(2000 * i, ROW) for i in range(4000)]),
            "a test is already running .*supply valve",
        ),
        (
            ScriptedDevice((0, b"Hz? "), (300_000, HEAD + ROW)),
            "no row for 0.5 s after sample 7,.*no stop",
        ),
        (
            ScriptedDevice((0, b"Hz? "), (300_000, b"\xff" * 9 + b"\r")),
            "`done`; last text bytes that are not text;",
        ),
        (
            ScriptedDevice((0, b"Hz? ")),
            "no row for 5 s after the answer, and no `done`; .*supply valve",
        ),
        (
            ScriptedDevice((0, b"Hz? "), (300_000, HEAD + ROW), (310_000, b"Hz?\r")),
            r"last text 'Hz\?'",
        ),
        (PublishedFirmware(replay_log(make_log(frequency=1.0))), "sent 2 Hz, .* 1 Hz: .*no stop"),
    ],
)
def test_every_failure_raises_an_error_and_closes_the_port(device, message):
    port = VirtualPort(device)
    with pytest.raises(RigError, match=message):
        record(port, 2.0, clock=port.ns)
    assert not port.open


def test_an_error_of_the_sink_is_not_reported_as_a_lost_port():
    def full(at, piece):
        raise OSError("No space left on device")

    port = VirtualPort(PublishedFirmware(replay_log(make_log())))
    with pytest.raises(OSError, match="No space"):
        PublishedManifold(port, clock=port.ns).run_test(2.0, sink=full)
    assert not port.open


def test_a_paused_program_loses_no_rows():
    """The rows wait in the buffer during the pause."""
    port = VirtualPort(PublishedFirmware(replay_log(make_log())))

    def slow(at, row):
        if row.number == 100:
            port.now_us += 900_000

    outcome = PublishedManifold(port, clock=port.ns).run_test(2.0, slow)
    assert (outcome.rows, outcome.findings) == (500, ())


def test_a_long_read_does_not_count_as_silence():
    """The program pauses in a read and then gets the first of the waiting bytes."""

    class StallingPort(VirtualPort):
        def read(self, size):
            if 600_000 < self.now_us < 700_000:
                self.now_us += 900_000
                self.arriving += self.device.tick(self.now_us)
                size = 1
            return super().read(size)

    port = StallingPort(PublishedFirmware(replay_log(make_log())))
    assert record(port, 2.0, clock=port.ns)[0].findings == ()


def test_a_question_in_two_parts_is_answered_after_the_second():
    port = VirtualPort(
        ScriptedDevice((0, b"Frequency"), (20_000, b" in Hz: "), (300_000, make_log()))
    )
    assert record(port, 2.0, clock=port.ns)[1] == make_log()


@pytest.mark.parametrize(("end", "last_end"), [("\r\n", True), ("\r", True), ("\r", False)])
def test_a_question_directly_after_done_belongs_to_the_next_test(end, last_end):
    log = make_log(end, last_end)
    port = VirtualPort(ScriptedDevice((0, b"Hz? "), (300_000, log + b"Hz? "), (600_000, log)))
    manifold = PublishedManifold(port, clock=port.ns)
    for _ in range(2):
        pieces = []
        manifold.run_test(2.0, sink=lambda at, piece, pieces=pieces: pieces.append(piece))
        assert b"".join(pieces) == log


def test_a_port_unplugged_during_a_test_is_an_error():
    with serve_in_thread(PublishedFirmware(replay_log(make_log()))) as served:
        port = open_port(served.path)
        seen = []

        def unplug_at_row_50(at, row):
            seen.append(row.number)
            if row.number == 50:
                served.unplug()

        with pytest.raises(PortLost, match=r"gone .*no stop command .* supply valve"):
            PublishedManifold(port).run_test(2.0, unplug_at_row_50)
        assert seen[:50] == list(range(1, 51))
        assert not port.is_open


def test_a_host_that_does_not_read_receives_the_latest_bytes():
    class CountingDevice:
        """A device that sends the number of bytes it has sent."""

        def __init__(self):
            self.sent = 0

        def feed(self, piece, now_us):
            return piece

        def tick(self, now_us):
            self.sent += 4000
            return b"".join(b"%07d\n" % n for n in range(self.sent - 4000, self.sent, 8))

    device = CountingDevice()
    with serve_in_thread(device) as served:
        port = open_port(served.path)
        while device.sent < 1_000_000:
            time.sleep(0.01)
        received = b""
        while len(received) < BACKLOG // 2:
            received += port.read(4096)
        port.close()
    numbers = [int(line) for line in received.split(b"\n")[1:-1] if len(line) == 7]
    gaps = np.flatnonzero(np.diff(numbers) != 8)
    assert len(gaps) <= 2
    assert numbers[-1] > 1_000_000 - BACKLOG


class RecordingChamber:
    """A chamber that records the valves' duties."""

    def __init__(self):
        self.pressure, self.duties = 200e3, []

    def __call__(self, fill, vent, seconds):
        self.duties.append((fill, vent))
        error = COUNT * (fill - vent) / 10.0
        self.pressure += seconds * Valves().rate(self.pressure, error)
        return self.pressure


def test_a_simulated_test_reads_as_a_log_of_the_firmware(tmp_path):
    chamber = RecordingChamber()
    port = VirtualPort(PublishedFirmware(simulate_frequency_test(chamber, cycles=3)))
    outcome, recorded, rows = record(port, 2.0, clock=port.ns)
    assert outcome.findings == ()
    path = tmp_path / "made.txt"
    path.write_bytes(recorded)
    log = read_log(path)
    assert log.findings == ()
    assert (log.frequency, log.period, len(log.t)) == (2.0, PERIOD, 750)
    np.testing.assert_allclose(
        log.command, 291.0 + 200.0 * np.sin(2 * np.pi * 2.0 * (log.t + PERIOD)), atol=0.006
    )
    error = log.command - log.pressure
    duty = np.minimum(250.0, 10.0 * abs(error))
    np.testing.assert_allclose(np.where(error > 0, log.fill, log.vent), duty, atol=1.0)
    assert not np.where(error > 0, log.vent, log.fill).any()
    assert chamber.duties == [(0, 0), *((row.fill, row.vent) for _, row in rows[:-1])]
    assert log.pressure_Pa[-1] == pytest.approx(chamber.pressure, abs=0.51 * COUNT)
    assert np.ptp(log.pressure_Pa) > 20e3


def test_the_simulated_firmware_ignores_input_during_a_test():
    """The input answers the next question, as in the original firmware."""
    firmware = PublishedFirmware(replay_log(make_log()))
    sent = firmware.tick(0) + firmware.feed(b"2.0\n", 1000)
    for now in range(1000, 5_000_000, 1000):
        if now == 500_000:
            sent += firmware.feed(b"stop\n3.0", now)
        sent += firmware.tick(now)
    assert sent.count(b"NEW TEST") == 2
    assert sent.startswith(b"Enter frequency in Hz: " + make_log() + b"Enter")
