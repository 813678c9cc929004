"""The published firmware's dialogue: parsed, driven, and simulated from the logs' own text."""

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
from rig.simulated.terminal import BACKLOG, in_process, in_thread
from tests.support.synthetic_log import log_lines

REAL = (
    "0.25", "0.55556", "0.86111", "1.1667", "1.4722", "1.7778", "2.0833", "2.3889", "2.6944", "3"
)  # fmt: skip
STALE = "1,0,250,406.25,-27.75,434"


def made(end="\r", last_end=True, stale=False, frequency=2.0, cycles=2.0):
    """A small log as bytes."""
    lines = log_lines(frequency=frequency, cycles=cycles)
    text = end.join([STALE, *lines[:-1], f"done{len(lines)}"] if stale else lines)
    return (text + end * last_end).encode()


def naive_rows(log):
    """The rows after the column names, by plain splitting."""
    body = re.split(r"[\r\n]+", log.decode().partition("pressure\r")[2] or log.decode())
    rows = [line.split(",") for line in body if re.match(r"\d+,", line)]
    return [(int(a), int(b), int(c), float(d), float(e), int(f)) for a, b, c, d, e, f in rows]


class Wire:
    """A port with a device on it, in virtual time: every read in vain lasts a millisecond."""

    name = "wire"

    def __init__(self, device, pieces=lambda: 4096):
        self.device, self.pieces = device, pieces
        self.now_us, self.sent, self.coming, self.open = 0, b"", b"", True

    @property
    def in_waiting(self):
        self.coming += self.device.tick(self.now_us)
        return len(self.coming)

    def read(self, size):
        if not self.coming:
            self.now_us += 1000
            self.coming = self.device.tick(self.now_us)
        size = min(size, self.pieces()) if self.coming else 0
        piece, self.coming = self.coming[:size], self.coming[size:]
        return piece

    def write(self, piece):
        self.sent += piece
        self.coming += self.device.feed(piece, self.now_us)

    def close(self):
        self.open = False

    def ns(self):
        return 1000 * self.now_us


class Says:
    """A device that says one thing at a time [us], in order, and hears nothing."""

    def __init__(self, *speech):
        self.speech = list(speech)

    def feed(self, piece, now_us):
        return b""

    def tick(self, now_us):
        return self.speech.pop(0)[1] if self.speech and self.speech[0][0] <= now_us else b""


def record(port, frequency, **keywords):
    """(outcome, bytes, [(time, row)]) of a test."""
    pieces, rows = [], []
    manifold = PublishedManifold(port, **keywords)
    outcome = manifold.run(
        frequency, lambda at, row: rows.append((at, row)), lambda at, piece: pieces.append(piece)
    )
    return outcome, b"".join(pieces), rows


def record_in_virtual_time(log, frequency, pieces=lambda: 4096, **keywords):
    wire = Wire(PublishedFirmware(replay_log(log, **keywords)), pieces)
    return record(wire, frequency, clock=wire.ns)


def same_log(tmp_path, recorded, log):
    """That the reader of logs finds the same in both."""
    paths = tmp_path / "recorded.txt", tmp_path / "log.txt"
    for path, content in zip(paths, (recorded, log), strict=True):
        path.write_bytes(content)
    a, b = map(read_log, paths)
    for name in ("t", "command", "pressure", "fill", "vent"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    assert (a.frequency, a.period, a.findings) == (b.frequency, b.period, b.findings)


@pytest.mark.parametrize("name", REAL)
def test_what_is_recorded_of_a_replayed_real_log_is_the_log_byte_for_byte(data, tmp_path, name):
    log = (data / "manifold" / f"{name}.txt").read_bytes()
    frequency = float(re.search(rb"frequency:\s+([\d.]+)", log)[1])
    chance = random.Random(0)
    outcome, recorded, rows = record_in_virtual_time(log, frequency, lambda: chance.randint(1, 40))
    assert recorded == log
    assert [tuple(row) for _, row in rows] == naive_rows(log)
    assert (outcome.torn, outcome.lost, outcome.rows) == (0, 0, len(rows))
    assert outcome.stale == (name in ("1.1667", "2.3889"))
    same_log(tmp_path, recorded, log)


@pytest.mark.parametrize("end", ["\r", "\n", "\r\n"])
@pytest.mark.parametrize("last_end", [True, False])
@pytest.mark.parametrize("size", [1, 7, 4096])
def test_every_line_end_and_every_split_record_the_log_itself(tmp_path, end, last_end, size):
    log = made(end, last_end, stale=size == 7)
    outcome, recorded, rows = record_in_virtual_time(log, 2.0, lambda: size)
    assert recorded == log
    assert [tuple(row) for _, row in rows] == naive_rows(made())
    assert outcome.header == Header(2.0, 1.0, 2.0, 0.002, 2.0)
    assert (
        outcome.lines
        == outcome.counted
        == len(log_lines(frequency=2.0, cycles=2.0)) - 1 + (size == 7)
    )
    assert outcome.findings == (
        ("1 rows of an earlier test came before the header",) if size == 7 else ()
    )
    same_log(tmp_path, recorded, log)


def test_rows_come_at_the_times_at_which_they_are_sent():
    _, _, rows = record_in_virtual_time(made(), 2.0)
    steps = np.diff([at for at, _ in rows])
    np.testing.assert_allclose(steps, 2e6, atol=1e6)


def test_tests_follow_each_other_on_one_port():
    log = made()
    wire = Wire(PublishedFirmware(replay_log(log)))
    manifold = PublishedManifold(wire, clock=wire.ns)
    for _ in range(3):
        pieces = []
        manifold.run(2.0, sink=lambda at, piece, pieces=pieces: pieces.append(piece))
        assert b"".join(pieces) == log
    assert wire.sent == 3 * b"2.000000\n"
    assert wire.open


def test_through_a_terminal_of_another_process_the_log_is_recorded_byte_for_byte(tmp_path):
    log = made(frequency=5.0, cycles=4.0)
    with in_process(_replayed, log, 500) as served:
        port = open_port(served.path)
        outcome, recorded, rows = record(port, 5.0)
        assert recorded == log
        assert len(rows) == outcome.rows == 400
        same_log(tmp_path, recorded, log)
        served.unplug()
        with pytest.raises(PortLost, match="gone"):
            record(port, 5.0)
    assert not port.is_open


@pytest.mark.slow
def test_all_real_logs_pass_through_a_terminal_byte_for_byte(data):
    for name in REAL:
        log = (data / "manifold" / f"{name}.txt").read_bytes()
        frequency = float(re.search(rb"frequency:\s+([\d.]+)", log)[1])
        with in_process(_replayed, log, 100, backlog=2**20) as served:
            port = open_port(served.path)
            outcome, recorded, _ = record(port, frequency)
            port.close()
        assert recorded == log, name
        assert (outcome.torn, outcome.lost) == (0, 0)


def _replayed(log, period_us):
    return PublishedFirmware(replay_log(log, period_us))


def _no_device():
    raise SystemExit(1)


def test_a_device_that_does_not_start_is_told():
    with pytest.raises(RigError, match="did not start"):
        with in_process(_no_device):
            pass


def parsed(dialogue, *pieces):
    return [event for piece in pieces for event in dialogue.feed(piece)]


def test_a_row_that_lost_a_byte_is_counted_and_not_accepted():
    log, chance = made(), random.Random(1)
    true = {row[0]: row for row in naive_rows(log)}
    head = log.index(b"\r1,") + 1
    for _ in range(150):
        at = chance.randrange(head, len(log) - 8)
        dialogue = Dialogue()
        dialogue.answered()
        events = parsed(dialogue, log[:at] + log[at + 1 :])
        rows = [event for event in events if isinstance(event, LogRow)]
        # Nothing in a row tells of damage to the valves' duties.
        assert all(tuple(r[:1] + r[3:]) == true[r.number][:1] + true[r.number][3:] for r in rows)
        assert dialogue.rows == len(rows) >= len(true) - 2
        valves_hit = rows != [LogRow(*row) for row in true.values()] and len(rows) == len(true)
        assert valves_hit or dialogue.torn == 1
        ends = (1, len(true))
        assert dialogue.lost == sum(ends[0] < n < ends[1] for n in true.keys() - {*(
            r.number for r in rows)})  # fmt: skip


def test_a_number_that_grew_a_digit_costs_its_row_alone():
    log = made().replace(b"\r100,", b"\r9100,")
    outcome, _, rows = record_in_virtual_time(log, 2.0)
    assert (outcome.torn, outcome.lost) == (1, 1)
    assert [row.number for _, row in rows] == [n for n in range(1, 501) if n != 100]


def test_rows_go_on_after_a_long_gap():
    lines = made().split(b"\r")
    outcome, _, rows = record_in_virtual_time(b"\r".join(lines[:100] + lines[300:]), 2.0)
    # The first row after the gap has to be confirmed by the next.
    assert outcome.lost == 201
    assert outcome.findings[-1] == "the firmware counts 507 lines, 307 came"
    assert rows[-1][1].number == 500


def test_a_torn_line_of_column_names_costs_no_row():
    log = made().replace(b"pressureError", b"pressurError")
    outcome, _, rows = record_in_virtual_time(log, 2.0)
    assert len(rows) == 500
    assert (outcome.torn, outcome.header.frequency) == (1, 2.0)


def test_noise_without_a_line_end_is_dropped_and_counted():
    dialogue = Dialogue()
    dialogue.answered()
    parsed(dialogue, *[b"\xfe" * 100] * 60)
    assert dialogue.torn == 10
    assert len(dialogue.rest) <= 512


def test_a_question_is_known_by_the_silence_after_it():
    dialogue = Dialogue()
    assert parsed(dialogue, b"Sensor ok\r\nEnter freq", b"uency: ") == []
    assert dialogue.quiet() == [Question("Enter frequency:")]
    assert parsed(dialogue, b"\r\n> ") == []
    assert dialogue.quiet() == [Question("Enter frequency:")]
    dialogue.answered()
    assert dialogue.quiet() == []


def test_the_header_of_a_test_that_runs_is_no_question():
    dialogue = Dialogue()
    parsed(dialogue, b"frequency:    0.250000 Hz\r")
    assert dialogue.quiet() == []
    parsed(dialogue, b"Frequency?\r" + STALE.encode() + b"\r")
    assert dialogue.quiet() == []


def test_what_follows_done_is_left_for_the_next_test():
    dialogue = Dialogue()
    dialogue.answered()
    assert parsed(dialogue, b"done12\r") == []
    assert parsed(dialogue, b"\nFrequency") == [Done(12)]
    assert dialogue.rest == b"Frequency"


def test_counts_become_pascals_as_in_the_reader_of_logs():
    assert counts_to_pascal(300.0) == pytest.approx(PA_PER_PSI * psi(300.0))
    row = LogRow(1, 0, 250, 91.02, -197.98, 289)
    assert row.pressure_Pa == counts_to_pascal(289)
    assert row.command_Pa == counts_to_pascal(91.02)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -1.0, 0.0, 0.05, 50.0])
def test_a_frequency_that_is_not_allowed_never_goes_on_the_wire(bad):
    wire = Wire(PublishedFirmware(replay_log(made())))
    with pytest.raises(RigError, match=r"frequency: given .* Hz; allowed 0\.1 to 5 Hz"):
        record(wire, bad, clock=wire.ns)
    assert wire.sent == b""


ROW = b"7,0,250,406.25,-27.75,434\r"
HEAD = made()[: made().index(b"\r1,") + 1]


@pytest.mark.parametrize(
    ("device", "message"),
    [
        (Says(), "no question for a frequency in 5 s, and nothing else; .*Reset the board"),
        (Says((0, b"Hello\r\n")), "but 'Hello'"),
        (Says((0, bytes(range(130, 250)) + b"\r")), "but bytes that are no text; .*rig check"),
        (Says(*[(2000 * i, ROW) for i in range(4000)]), "a test is running, .*supply valve"),
        (Says((0, b"Hz? "), (300_000, HEAD + ROW)), "no row for 0.5 s after sample 7,.*no stop"),
        (
            Says((0, b"Hz? "), (300_000, b"\xff" * 9 + b"\r")),
            "`done`; it said bytes that are no text;",
        ),
        (Says((0, b"Hz? ")), "no row for 5 s after the answer, and no `done`; .*supply valve"),
        (Says((0, b"Hz? "), (300_000, HEAD + ROW), (310_000, b"Hz?\r")), r"it said 'Hz\?'"),
        (PublishedFirmware(replay_log(made(frequency=1.0))), "asked for 2 Hz, .* 1 Hz: .*no stop"),
    ],
)
def test_what_does_not_go_as_it_should_is_told_and_the_port_closed(device, message):
    wire = Wire(device)
    with pytest.raises(RigError, match=message):
        record(wire, 2.0, clock=wire.ns)
    assert not wire.open


def test_an_error_of_the_sink_is_not_taken_for_a_lost_port():
    def full(at, piece):
        raise OSError("No space left on device")

    wire = Wire(PublishedFirmware(replay_log(made())))
    with pytest.raises(OSError, match="No space"):
        PublishedManifold(wire, clock=wire.ns).run(2.0, sink=full)
    assert not wire.open


def test_a_program_that_was_not_run_for_a_while_records_on():
    """The rows wait in the buffer meanwhile."""
    wire = Wire(PublishedFirmware(replay_log(made())))

    def slow(at, row):
        if row.number == 100:
            wire.now_us += 900_000

    outcome = PublishedManifold(wire, clock=wire.ns).run(2.0, slow)
    assert (outcome.rows, outcome.findings) == (500, ())


def test_a_read_that_takes_long_is_not_taken_for_silence():
    """The program was not run, and then got the first byte of what had come."""

    class Stalls(Wire):
        def read(self, size):
            if 600_000 < self.now_us < 700_000:
                self.now_us += 900_000
                self.coming += self.device.tick(self.now_us)
                size = 1
            return super().read(size)

    wire = Stalls(PublishedFirmware(replay_log(made())))
    assert record(wire, 2.0, clock=wire.ns)[0].findings == ()


def test_a_question_in_two_parts_is_answered_after_the_second():
    wire = Wire(Says((0, b"Frequency"), (20_000, b" in Hz: "), (300_000, made())))
    assert record(wire, 2.0, clock=wire.ns)[1] == made()


@pytest.mark.parametrize(("end", "last_end"), [("\r\n", True), ("\r", True), ("\r", False)])
def test_a_question_right_behind_done_is_the_next_test_s(end, last_end):
    log = made(end, last_end)
    wire = Wire(Says((0, b"Hz? "), (300_000, log + b"Hz? "), (600_000, log)))
    manifold = PublishedManifold(wire, clock=wire.ns)
    for _ in range(2):
        pieces = []
        manifold.run(2.0, sink=lambda at, piece, pieces=pieces: pieces.append(piece))
        assert b"".join(pieces) == log


def test_a_port_unplugged_in_mid_test_is_told():
    with in_thread(PublishedFirmware(replay_log(made()))) as served:
        port = open_port(served.path)
        seen = []

        def pull(at, row):
            seen.append(row.number)
            if row.number == 50:
                served.unplug()

        with pytest.raises(PortLost, match=r"gone .*no stop command .* supply valve"):
            PublishedManifold(port).run(2.0, pull)
        assert seen[:50] == list(range(1, 51))
        assert not port.is_open


def test_a_host_that_does_not_read_finds_the_latest_bytes():
    class Counts:
        """Says how many bytes it has said."""

        def __init__(self):
            self.said = 0

        def feed(self, piece, now_us):
            return piece

        def tick(self, now_us):
            self.said += 4000
            return b"".join(b"%07d\n" % n for n in range(self.said - 4000, self.said, 8))

    device = Counts()
    with in_thread(device) as served:
        port = open_port(served.path)
        while device.said < 1_000_000:
            time.sleep(0.01)
        heard = b""
        while len(heard) < BACKLOG // 2:
            heard += port.read(4096)
        port.close()
    numbers = [int(line) for line in heard.split(b"\n")[1:-1] if len(line) == 7]
    gaps = np.flatnonzero(np.diff(numbers) != 8)
    assert len(gaps) <= 2
    assert numbers[-1] > 1_000_000 - BACKLOG


class Chamber:
    """A plant that keeps the duties it was given."""

    def __init__(self):
        self.pressure, self.duties = 200e3, []

    def __call__(self, fill, vent, seconds):
        self.duties.append((fill, vent))
        error = COUNT * (fill - vent) / 10.0
        self.pressure += seconds * Valves().rate(self.pressure, error)
        return self.pressure


def test_a_test_made_of_a_plant_reads_as_a_log_of_the_firmware(tmp_path):
    chamber = Chamber()
    wire = Wire(PublishedFirmware(simulate_frequency_test(chamber, cycles=3)))
    outcome, recorded, rows = record(wire, 2.0, clock=wire.ns)
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


def test_the_simulated_firmware_hears_nothing_in_mid_test():
    """What was sent meanwhile answers the next question, as in the original."""
    firmware = PublishedFirmware(replay_log(made()))
    said = firmware.tick(0) + firmware.feed(b"2.0\n", 1000)
    for now in range(1000, 5_000_000, 1000):
        if now == 500_000:
            said += firmware.feed(b"stop\n3.0", now)
        said += firmware.tick(now)
    assert said.count(b"NEW TEST") == 2
    assert said.startswith(b"Enter frequency in Hz: " + made() + b"Enter")
