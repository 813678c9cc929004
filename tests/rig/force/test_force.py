"""Force sensors: the order of records, their sampling times, calibrations, and error messages."""

import socket
import struct
import sys
import time
import types

import numpy as np
import pytest

from rig.errors import RigError
from rig.force import ati_rdt as rdt
from rig.force.ati_net import NetCalibration, NetForce
from rig.force.ni_daq import GaugeCalibration, GaugeForce
from rig.force.sensor import SensorMounting
from rig.recording.clock import host_sample_times
from rig.simulated.bench import HostClockedRig
from rig.simulated.force_sensor import COUNTS, LossyNetwork, SimulatedForceBox, SimulatedForceSensor
from rig.simulated.rig import STEP, SimulatedRig
from rig.simulated.tank import BenchTank
from rig.trial.health_check import check_force

CALIBRATION = NetCalibration(COUNTS, COUNTS)
RATE = 1000.0


def clock_in_force(start):
    """Returns a wrench that encodes its sampling time: Fz [N] is the time since `start` [s]."""
    return lambda t: np.array([0.1, -0.2, t - start, 0.0, 0.0, 0.01])


def at_rest(t):
    return np.zeros(6)


def virtual_stream(
    seconds, line, *, drift=0.0, delay=0.3e-3, jitter=0.0, start=50.0, seed=1, **box
):
    """Returns (host_ns, datagrams) of a stream in virtual time, in order of arrival.

    Delays [s] are `delay` plus an exponential `jitter`. The host sometimes sleeps for 40 ms.
    """
    random = np.random.default_rng(seed)
    box = SimulatedForceBox(clock_in_force(start), RATE, noise=0.0, seed=seed, **box)
    host_ns, datagrams, asleep_until, last = [], [], 0.0, 0.0
    for k in range(round(seconds * RATE)):
        t = start + k * box.period / (1 + drift)
        arrival = max(last, asleep_until, t + delay + jitter * random.exponential())
        if random.random() < 2e-4:
            asleep_until = arrival + 0.04
        for datagram in line.transmit(box.record(k, t)):
            last = arrival
            host_ns.append(round(1e9 * arrival))
            datagrams.append(datagram)
    return host_ns, datagrams


def within(dropped, records):
    """Returns the numbers of dropped records between the first and the last received record."""
    numbers = 1 + np.array(dropped, int)
    return numbers[(numbers > records.seq[0]) & (numbers < records.seq[-1])]


def sampled_s(records):
    """Returns the true sampling times of the present records, encoded in Fz [s since the start]."""
    return records.counts[records.present, 2] / COUNTS


def test_a_minute_with_lost_and_reordered_records_is_restored_without_a_shift():
    line = LossyNetwork(drop=0.02, reorder=0.02, duplicate=0.01, seed=3)
    host_ns, datagrams = virtual_stream(60.0, line, drift=120e-6, jitter=0.4e-3)
    records = rdt.record_table(host_ns, datagrams)
    assert len(line.dropped) > 1000 and line.late > 1000 and line.doubled > 400
    np.testing.assert_array_equal(records.missing, within(line.dropped, records))
    assert records.duplicates == line.doubled
    assert 0.9 * line.late < records.late <= line.late  # a delayed record may still be in order
    off = 1e-9 * records.times()[records.present] - 50.0 - sampled_s(records) - 0.3e-3
    assert np.abs(off).max() < 0.05e-3
    assert len(records.seq) / RATE == pytest.approx(60.0, abs=0.02)
    assert (
        len(records.seq) - records.present.sum() > RATE
    )  # in order of arrival, the times would be off by 1 s


@pytest.mark.parametrize("drift", [-300e-6, 0.0, 300e-6])
def test_a_drifting_clock_is_followed_for_ten_minutes(drift):
    """For speed, only every tenth record is used; the fitted line is the same."""
    random = np.random.default_rng(5)
    number = np.arange(0, 600_000, 10)
    sampled = 7.0 + number / RATE / (1 + drift)
    arrived = sampled + 0.2e-3 + random.exponential(1e-3, len(number))
    times = host_sample_times(number, np.rint(1e9 * arrived).astype(np.int64), RATE, number)
    assert np.abs(1e-9 * times - sampled - 0.2e-3).max() < 0.1e-3


def test_missing_records_are_reported_as_runs():
    _, datagrams = virtual_stream(0.02, LossyNetwork())
    kept = [d for k, d in enumerate(datagrams) if k not in (3, 7, 8, 9)]
    records = rdt.record_table(range(len(kept)), kept)
    assert records.missing.tolist() == [4, 8, 9, 10]
    assert records.missing.tolist() == [4, 8, 9, 10]
    assert not records.counts[3].any() and records.counts[4, 2] > 0


def test_a_copy_after_later_records_is_a_duplicate_and_not_late():
    _, datagrams = virtual_stream(0.006, LossyNetwork())
    received = [datagrams[k] for k in (0, 1, 3, 1, 2, 4, 5)]
    records, tally = rdt.record_table([10**6 * k for k in range(7)], received), rdt.StreamTally()
    for datagram in received:
        tally.count(*struct.unpack_from(">I4xI", datagram))
    assert (records.late, records.duplicates) == (tally.late, tally.duplicates) == (1, 1)
    assert records.host_ns.tolist() == [0, 10**6, 4 * 10**6, 2 * 10**6, 5 * 10**6, 6 * 10**6]


def test_the_live_tally_agrees_with_the_table():
    line = LossyNetwork(drop=0.05, reorder=0.05, duplicate=0.05, seed=8)
    host_ns, datagrams = virtual_stream(3.0, line)
    records, tally = rdt.record_table(host_ns, datagrams), rdt.StreamTally()
    for datagram in datagrams:
        tally.count(*struct.unpack_from(">I4xI", datagram))
    before = set(range(1, int(records.seq[0])))
    assert tally.missing == set(records.missing.tolist()) | before
    assert (tally.late, tally.duplicates) == (records.late, records.duplicates)


def test_numbers_continue_over_the_overflow_of_32_bits():
    box, start = SimulatedForceBox(at_rest, RATE), 2**32 - 6
    datagrams = []
    for k in range(12):
        fields = list(rdt.RECORD.unpack(box.record(k, k / RATE)))
        fields[0], fields[1] = (start + k) % 2**32, (2**32 - 20 + 7 * k) % 2**32
        datagrams.append(rdt.RECORD.pack(*fields))
    records = rdt.record_table([10**6 * k for k in range(11)], datagrams[:4] + datagrams[5:])
    assert records.missing.tolist() == [start + 4]
    assert records.rate == RATE


def test_the_box_time_continues_over_the_overflow_and_skips_late_records():
    box, start = rdt.BoxTime(), 2**32 - 10
    counts = [start, start + 7, start + 21, start + 14, start + 21, start + 28]
    found = [box.seconds(x % 2**32) for x in counts]
    assert found == [0.0, pytest.approx(0.001), pytest.approx(0.003), None, None,
                     pytest.approx(0.004)]  # fmt: skip


def test_a_record_without_a_measurement_is_invalid():
    assert not rdt.is_invalid(0) and not rdt.is_invalid(rdt.LATCHED)
    assert rdt.is_invalid(rdt.SATURATED) and rdt.is_invalid(rdt.ERROR)


def test_a_second_stream_in_a_recording_is_refused():
    one = virtual_stream(0.1, LossyNetwork())
    two = virtual_stream(0.1, LossyNetwork(), start=51.0, seed=2)
    with pytest.raises(RigError, match="datagram 100: given number 1, as if a new stream began"):
        rdt.record_table(one[0] + two[0], one[1] + two[1])


def test_arrivals_in_a_burst_are_refused():
    _, datagrams = virtual_stream(5.0, LossyNetwork())
    with pytest.raises(RigError, match="median delay of 5000 samples at 1000 Hz is"):
        rdt.record_table(range(5000), datagrams).times()


@pytest.mark.parametrize("size", [0, 35, 72])
def test_a_record_of_a_wrong_size_is_refused(size):
    _, datagrams = virtual_stream(0.01, LossyNetwork())
    datagrams[4] = bytes(size)
    with pytest.raises(RigError, match=f"datagram 4: given a datagram of {size} bytes; .* 36"):
        rdt.record_table(range(10), datagrams)


def test_an_empty_recording_is_refused():
    with pytest.raises(RigError, match="no records"):
        rdt.record_table([], [])


def test_a_stuck_sensor_is_reported_and_a_quiet_one_is_not():
    box = SimulatedForceBox(at_rest, RATE, noise=1e-5)
    datagrams = []
    for k in range(1000):
        box.stuck = 400 <= k < 700
        datagrams.append(box.record(k, k / RATE))
    forces = CALIBRATION.forces([10**6 * k for k in range(1000)], datagrams)
    assert 400 <= np.flatnonzero(forces.doubtful)[0] + 1 <= 401
    assert np.flatnonzero(forces.doubtful)[-1] == 699
    assert any("301 records of a stuck" in finding for finding in forces.findings)


def test_saturated_samples_are_marked():
    host_ns, datagrams = virtual_stream(2.0, LossyNetwork(), limit=1.5)  # Fz [N] is the time [s]
    forces = CALIBRATION.forces(host_ns, datagrams)
    assert not forces.doubtful[:1500].any()
    assert forces.doubtful[1502:].all()
    assert any("status 0x80020000: saturated" in finding for finding in forces.findings)
    assert np.max(forces.wrench[:, 2]) == pytest.approx(1.5)


@pytest.mark.parametrize(
    ("status", "box_error", "text"),
    [
        (0, False, ""),
        (rdt.LATCHED, False, ""),
        (rdt.ERROR | rdt.LATCHED, False, ""),
        (rdt.ERROR | rdt.SATURATED, False, "status 0x80020000: saturated"),
        (rdt.ERROR, True, "status 0x80000000: an error of the box"),
        (rdt.ERROR | rdt.SATURATED | 1, True, "status 0x80020001: saturated, an error of the box"),
    ],
)
def test_the_status_text_names_the_errors(status, box_error, text):
    assert rdt.has_box_error(status) == box_error
    assert rdt.status_text(status).startswith(text) and bool(text) == bool(rdt.status_text(status))


def test_lost_records_are_nan_and_the_others_are_forces():
    line = LossyNetwork(drop=0.1, seed=2)
    forces = NetCalibration(COUNTS, 2 * COUNTS).forces(*virtual_stream(1.0, line))
    lost = np.isnan(forces.wrench).any(axis=1)
    assert lost.sum() > 50
    kept = forces.wrench[~lost]
    np.testing.assert_allclose(kept[:, :2], np.tile([0.1, -0.2], (len(kept), 1)))
    np.testing.assert_allclose(kept[:, 5], 0.005)
    assert np.diff(forces.t_ns).min() == pytest.approx(1e6, rel=1e-3)


def test_the_mounting_selects_thrust_and_recoil():
    wrench = np.arange(1.0, 13.0).reshape(2, 6)
    thrust, recoil = SensorMounting("-Fz", "+Fx").thrust_and_recoil(wrench)
    assert thrust.tolist() == [-3.0, -9.0] and recoil.tolist() == [1.0, 7.0]
    for wrong in (("Fx", "+Fy"), ("+Tx", "+Fy"), ("+Fx", "-Fx")):
        with pytest.raises(RigError, match="force\\.(thrust|recoil)"):
            SensorMounting(*wrong)


# Calibration


def page(**changes):
    values = {"cfgcpf": "1000", "cfgcpt": "20000", "scfgfu": "N", "scfgtu": "Nm", **changes}
    inside = "".join(f"<{k}>{v}</{k}>" for k, v in values.items() if v is not None)
    return f"<?xml version='1.0'?><netft>{inside}</netft>".encode()


def test_units_of_the_page_are_converted():
    assert NetCalibration.from_page(page(), "box") == NetCalibration(1000.0, 20000.0)
    found = NetCalibration.from_page(page(scfgfu="lbf", scfgtu="lbf-in"), "box")
    assert found.counts_per_N == pytest.approx(1000 / 4.4482216)
    assert found.counts_per_Nm == pytest.approx(20000 / 0.11298483)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (page()[:-15], "incomplete XML"),
        (b"", "incomplete XML"),
        (page(cfgcpf=None), "cfgcpf is missing"),
        (page(cfgcpt="many"), "cfgcpt: given 'many'"),
        (page(cfgcpf="0"), "counts_per_N: given 0"),
        (page(cfgcpf="nan"), "counts_per_N: given nan"),
        (page(scfgfu="stone"), "scfgfu: given unit 'stone'"),
        (page(scfgtu=None), "scfgtu is missing"),
    ],
)
def test_an_incomplete_or_wrong_calibration_page_is_refused(content, message):
    with pytest.raises(RigError, match=message):
        NetCalibration.from_page(content, "http://box/netftapi2.xml")


def test_the_calibration_is_fetched_from_the_box():
    with SimulatedForceSensor(SimulatedForceBox(at_rest)) as sensor:
        port = sensor.serve_page()
        assert NetCalibration.fetch(sensor.host, port) == NetCalibration(COUNTS, COUNTS, "FT00000")
        sensor.page = sensor.page[:60]
        with pytest.raises(RigError, match="incomplete XML .* in the rig file"):
            NetCalibration.fetch(sensor.host, port)


def test_the_error_for_a_missing_page_names_its_address():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with pytest.raises(RigError, match=f"127.0.0.1:{port}/netftapi2.xml: cannot be read .*ping"):
        NetCalibration.fetch("127.0.0.1", port)


# The stream over a real socket


def wait_until(condition):
    """Waits up to 10 s until `condition()` is true, and returns its value."""
    end = time.monotonic() + 10.0
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    return condition()


def wait_for_error(force):
    """Waits up to 10 s until `check` raises an error, and returns its message."""
    end = time.monotonic() + 10.0
    while time.monotonic() < end:
        try:
            force.check()
        except RigError as error:
            return str(error)
        time.sleep(0.01)
    pytest.fail("check raised nothing")


def stream_over_socket(seconds, rate, line, **settings):
    """Returns the records of a loopback stream, the start time of its Fz [s], and the source."""
    host_ns, datagrams, start = [], [], time.monotonic()

    def sink(now, datagram):
        host_ns.append(now)
        datagrams.append(datagram)

    box = SimulatedForceBox(clock_in_force(start), rate, noise=0.0)
    with (
        SimulatedForceSensor(box, line, **settings) as sensor,
        NetForce(sensor.host, CALIBRATION, sensor.port, patience=10.0) as force,
    ):
        force.start(sink)
        time.sleep(seconds)
        force.check()
        force.stop()
        assert sensor.requests[-1] == rdt.STOP
    return rdt.record_table(host_ns, datagrams), start, force


def assert_located(records, start, line):
    """Asserts that the gaps are exact and the times wrong by less than half a sample."""
    np.testing.assert_array_equal(records.missing, within(line.dropped, records))
    off = 1e-9 * records.times()[records.present] - start - sampled_s(records)
    assert np.abs(off).max() < 0.5 / records.rate


def test_a_real_stream_has_exact_gaps_and_times():
    line = LossyNetwork(drop=0.1, reorder=0.1, duplicate=0.05, seed=4)
    records, start, force = stream_over_socket(4.0, 100.0, line, drift=100e-6)
    assert len(records.missing) > 10 and records.late > 10 and records.duplicates > 5
    assert_located(records, start, line)
    before = set(range(1, int(records.seq[0])))
    assert force.tally.missing == set(records.missing.tolist()) | before
    assert force.health().received == records.present.sum() + records.duplicates


@pytest.mark.slow
def test_a_real_minute_has_exact_gaps_and_times():
    line = LossyNetwork(drop=0.02, reorder=0.02, duplicate=0.01, seed=4)
    cpu = time.process_time()
    records, start, _ = stream_over_socket(60.0, RATE, line, drift=100e-6)
    cpu = time.process_time() - cpu
    off = 1e-9 * records.times()[records.present] - start - sampled_s(records)
    print(
        f"\n{records.present.sum()} records, {len(records.missing)} lost, "
        f"{records.late} late, {records.duplicates} twice; time off {1e3 * off.min():.3f} to "
        f"{1e3 * off.max():.3f} ms; box and reader take {cpu / 60:.1%} of a core"
    )
    assert len(records.seq) > 59_000
    assert_located(records, start, line)


def test_a_request_is_eight_bytes_and_limits_the_number_of_records():
    assert rdt.request_bytes(rdt.START, 5) == bytes.fromhex("1234 0002 00000005")
    assert rdt.request_bytes(rdt.BIAS) == bytes.fromhex("1234 0042 00000000")
    with (
        SimulatedForceSensor(SimulatedForceBox(at_rest)) as sensor,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as plain,
    ):
        plain.settimeout(1.0)
        plain.sendto(rdt.request_bytes(rdt.START, 5), (sensor.host, sensor.port))
        numbers = [rdt.RECORD.unpack(plain.recv(64))[0] for _ in range(5)]
        assert numbers == [1, 2, 3, 4, 5]
        plain.settimeout(0.1)
        with pytest.raises(TimeoutError):
            plain.recv(64)


def test_bias_makes_the_present_load_zero():
    box = SimulatedForceBox(lambda t: np.array([1.0, -2.0, 3.0, 0.1, 0.2, 0.3]), RATE)
    with (
        SimulatedForceSensor(box) as sensor,
        NetForce(sensor.host, CALIBRATION, sensor.port) as force,
    ):
        force.start(lambda now, datagram: None)
        assert wait_until(lambda: force.latest() is not None)
        np.testing.assert_allclose(force.latest()[1], box.wrench(0.0), atol=0.02)
        force.bias()
        assert wait_until(lambda: np.abs(force.latest()[1]).max() < 0.02)


def test_a_check_measures_rate_noise_and_losses_of_a_sensor_at_rest():
    box = SimulatedForceBox(
        lambda t: np.array([1.0, -2.0, 3.0, 0.0, 0.0, 0.0]), rate=500.0, noise=0.01
    )
    with (
        SimulatedForceSensor(box, LossyNetwork(drop=0.05, seed=1)) as sensor,
        NetForce(sensor.host, CALIBRATION, sensor.port) as force,
    ):
        found = check_force(force, SensorMounting("-Fy", "+Fx"))
    # Losses after the last received record cannot be detected.
    assert found.lost == pytest.approx(0.05 * 500.0, abs=15.0)
    assert found.rate == pytest.approx(0.95 * 500.0, rel=0.1)
    np.testing.assert_allclose(found.offset, [2.0, 1.0], atol=3e-3)
    np.testing.assert_allclose(found.noise, 0.01, rtol=0.25)
    assert "force records a second arrive; set the sensor's RDT rate to 1000" in found.findings[-1]


def test_a_second_start_begins_a_new_stream():
    streams = []
    with (
        SimulatedForceSensor(SimulatedForceBox(at_rest)) as sensor,
        NetForce(sensor.host, CALIBRATION, sensor.port) as force,
    ):
        for _ in range(2):
            datagrams = []
            force.start(lambda now, datagram, kept=datagrams: kept.append(datagram))
            time.sleep(0.1)
            force.stop()
            streams.append(rdt.record_table(range(len(datagrams)), datagrams))
    assert [stream.seq[0] for stream in streams] == [1, 1]


def test_a_sensor_that_falls_silent_is_an_error():
    with (
        SimulatedForceSensor(SimulatedForceBox(at_rest)) as sensor,
        NetForce(sensor.host, CALIBRATION, sensor.port, patience=0.5) as force,
    ):
        force.start(lambda now, datagram: None)
        force.check()
        sensor.silent = True
        assert f"{sensor.port}: no data for" in wait_for_error(force)


def test_a_sensor_that_does_not_answer_is_an_error():
    with (
        SimulatedForceSensor(SimulatedForceBox(at_rest)) as sensor,
        NetForce(sensor.host, CALIBRATION, sensor.port, patience=0.3) as force,
    ):
        sensor.silent = True
        with pytest.raises(RigError, match=f"127.0.0.1:{sensor.port}: no answer to 3 .*ping"):
            force.start(lambda now, datagram: None)


def test_an_unused_port_is_an_error():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with NetForce("127.0.0.1", CALIBRATION, port) as force:
        with pytest.raises(RigError, match=f"127.0.0.1:{port}: .*refused.*ping"):
            force.start(lambda now, datagram: None)


def test_an_unreachable_address_is_an_error():
    for host in ("255.255.255.255", "192.168..1"):
        with pytest.raises(RigError, match=f"force sensor {host}:49152: .*ping {host}"):
            NetForce(host, CALIBRATION)
    with pytest.raises(RigError, match="port: given 70000; allowed 1 to 65535"):
        NetForce("127.0.0.1", CALIBRATION, 70000)


def test_an_error_of_the_box_is_raised_but_saturation_is_counted():
    box = SimulatedForceBox(lambda t: np.full(6, 9.0), limit=5.0)
    with (
        SimulatedForceSensor(box) as sensor,
        NetForce(sensor.host, CALIBRATION, sensor.port) as force,
    ):
        force.start(lambda now, datagram: None)
        assert wait_until(lambda: force.health().saturated > 10)
        force.check()
        box.status = rdt.ERROR | 1 << 24
        assert "status 0x81020000: saturated, an error of the box" in wait_for_error(force)


def test_an_error_of_the_sink_is_raised_by_check():
    def sink(now, datagram):
        raise OSError("disk full")

    with (
        SimulatedForceSensor(SimulatedForceBox(at_rest)) as sensor,
        NetForce(sensor.host, CALIBRATION, sensor.port) as force,
    ):
        force.start(sink)
        assert "stopped reading: OSError('disk full')" in wait_for_error(force)


def test_a_datagram_of_another_size_is_an_error():
    kept = []
    with (
        SimulatedForceSensor(SimulatedForceBox(at_rest)) as sensor,
        NetForce(sensor.host, CALIBRATION, sensor.port) as force,
    ):
        sensor.box.record = lambda number, t: bytes(44)
        force.start(lambda now, datagram: kept.append(datagram))
        assert "given a datagram of 44 bytes" in wait_for_error(force)
    assert kept[0] == bytes(44)  # the recording contains it nevertheless


def test_a_load_above_the_largest_count_saturates_and_can_be_biased():
    box = SimulatedForceBox(lambda t: np.full(6, 1e9 * t), RATE)
    box.bias(-1.0)
    _, _, status, *counts = rdt.RECORD.unpack(box.record(0, 1.0))
    assert status & rdt.SATURATED and counts == [2000 * COUNTS] * 6


@pytest.mark.parametrize("settings", [{"rate": 0.0}, {"rate": 7001.0}, {"limit": 1001.0}])
def test_the_simulated_box_refuses_impossible_settings(settings):
    with pytest.raises(RigError, match=next(iter(settings))):
        SimulatedForceBox(at_rest, **settings)


@pytest.mark.parametrize("chance", [-0.1, 1.1, float("nan")])
def test_the_simulated_line_refuses_an_impossible_probability(chance):
    with pytest.raises(RigError, match="drop"):
        LossyNetwork(drop=chance)


# Gauges by an NI card

MATRIX = np.diag([2.0, 3.0, 5.0, 0.2, 0.3, 0.5]) + 0.01
CAL_FILE = """<?xml version="1.0" encoding="utf-8"?>
<FTSensor Serial="FT4167" BodyStyle="Delta" Family="DAQ" NumGages="6">
 <Calibration PartNumber="SI-130-10" ForceUnits="{force}" TorqueUnits="N-m" OutputRange="20"
   OutputBipolar="True">
{axes}
 </Calibration>
</FTSensor>
"""


def write_cal_file(tmp_path, force="N", matrix=MATRIX):
    axes = "\n".join(
        f'  <UserAxis Name="{name}" values=" {" ".join(f"{v:.6f}" for v in row)} " max="130"/>'
        for name, row in zip(("Fx", "Fy", "Fz", "Tx", "Ty", "Tz"), matrix, strict=True)
    )
    path = tmp_path / "FT4167.cal"
    path.write_text(CAL_FILE.format(force=force, axes=axes))
    return path


def test_the_matrix_of_a_calibration_file_is_converted_to_newtons(tmp_path):
    found = GaugeCalibration.read(write_cal_file(tmp_path))
    np.testing.assert_allclose(found.matrix, MATRIX)
    assert (found.volts, found.serial) == (10.0, "FT4167")
    in_kilonewtons = np.array(GaugeCalibration.read(write_cal_file(tmp_path, force="kN")).matrix)
    np.testing.assert_allclose(in_kilonewtons[:3], 1e3 * MATRIX[:3])
    np.testing.assert_allclose(in_kilonewtons[3:], MATRIX[3:])


def test_a_damaged_calibration_file_is_refused(tmp_path):
    path = write_cal_file(tmp_path)
    whole = path.read_text()
    for content, message in (
        (whole[:200], "incomplete XML"),
        (whole.replace("Calibration", "Other"), "the element Calibration is missing"),
        (whole.replace('"N"', '"stone"'), "ForceUnits: given unit 'stone'"),
        (whole.replace('Name="Ty"', 'Name="Tw"'), "UserAxis Ty needs 6 numbers"),
        (whole.replace("3.010000", "three"), "UserAxis Fy needs 6 numbers"),
    ):
        path.write_text(content)
        with pytest.raises(RigError, match=message):
            GaugeCalibration.read(path)
    with pytest.raises(RigError, match="cannot be read"):
        GaugeCalibration.read(tmp_path / "absent.cal")


def gauge_block(first, volts):
    return struct.pack("<Q", first) + np.asarray(volts, "<f8").tobytes()


def test_gauge_voltages_become_forces_and_a_lost_block_is_nan():
    calibration = GaugeCalibration(MATRIX.tolist(), zero=(0.5,) * 6)
    volts = np.random.default_rng(0).uniform(-5, 5, (1000, 6))
    volts[333, 4] = -9.99
    blocks = [(k, gauge_block(k, volts[k : k + 20])) for k in range(0, 1000, 20) if k != 500]
    late = np.random.default_rng(1).exponential(1e6, len(blocks))
    host_ns = [10**9 + (k + 19) * 10**6 + int(d) for (k, _), d in zip(blocks, late, strict=True)]
    forces = calibration.forces(host_ns, [block for _, block in blocks])
    lost = np.isnan(forces.wrench[:, 0])
    assert np.flatnonzero(lost).tolist() == list(range(500, 520))
    np.testing.assert_allclose(forces.wrench[~lost], ((volts - 0.5) @ MATRIX.T)[~lost])
    assert np.flatnonzero(forces.doubtful).tolist() == [333]
    assert np.abs(forces.t_ns - 10**9 - 10**6 * np.arange(1000)).max() < 0.3e6
    assert forces.findings == ("20 of 1000 samples missing", "1 samples saturated")


def test_without_nidaqmx_the_error_names_the_packages_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "nidaqmx", None)
    with pytest.raises(RigError, match=r"nidaqmx is missing; install the extra ni .*NI-DAQmx"):
        GaugeForce("Dev1/ai0:5", GaugeCalibration(MATRIX.tolist()))


class FakeCard:
    """The used part of nidaqmx: a card with constant voltages and blocks of 20 ms."""

    class Error(Exception):
        pass

    def __init__(self, inputs=6):
        self.volts, self.closed, self.broken = np.full(6, 0.25), False, False
        self.ai_channels, self.timing, self.in_stream = [None] * inputs, self, None
        self.samp_clk_rate = 1000.0
        channels = types.SimpleNamespace(add_ai_voltage_chan=lambda *a, **k: None)
        self.ai_channels = type("Channels", (list,), vars(channels))(self.ai_channels)

    def cfg_samp_clk_timing(self, rate, **how):
        self.samp_clk_rate = rate

    def start(self):
        pass

    stop = start

    def close(self):
        self.closed = True

    def read_many_sample(self, block, count, timeout):
        time.sleep(0.02)
        if self.broken:
            raise FakeCard.Error("Device has been removed.\nStatus Code: -88705")
        block[:] = self.volts[:, None]

    def install(self, monkeypatch):
        named = types.SimpleNamespace
        modules = {
            "nidaqmx": types.ModuleType("nidaqmx"),
            "nidaqmx.constants": types.ModuleType("nidaqmx.constants"),
            "nidaqmx.stream_readers": types.ModuleType("nidaqmx.stream_readers"),
        }
        top, constants, readers = modules.values()
        top.Task, top.errors = lambda: self, named(Error=FakeCard.Error)
        top.constants, top.stream_readers = constants, readers
        constants.TerminalConfiguration = named(DIFF=1)
        constants.AcquisitionType = named(CONTINUOUS=1)
        readers.AnalogMultiChannelReader = lambda stream: self
        for name, module in modules.items():
            monkeypatch.setitem(sys.modules, name, module)


def test_a_card_streams_biases_and_reports_that_it_is_unplugged(monkeypatch):
    card, kept = FakeCard(), []
    card.install(monkeypatch)
    with GaugeForce("Dev1/ai0:5", GaugeCalibration(MATRIX.tolist())) as force:
        force.start(lambda now, block: kept.append((now, block)))
        np.testing.assert_allclose(force.latest()[1], MATRIX @ card.volts)
        force.bias()
        np.testing.assert_allclose(force.latest()[1], np.zeros(6), atol=1e-12)
        card.volts = np.full(6, 0.75)
        assert wait_until(lambda: np.allclose(force.latest()[1], MATRIX @ np.full(6, 0.5)))
        assert force.health().received >= 20 * 10
        card.broken = True
        assert "Dev1/ai0:5: Device has been removed.; check the card" in wait_for_error(force)
    assert card.closed
    assert [struct.unpack_from("<Q", block)[0] for _, block in kept[:3]] == [0, 20, 40]


def test_a_card_with_five_inputs_is_refused(monkeypatch):
    card = FakeCard(inputs=5)
    card.install(monkeypatch)
    with pytest.raises(RigError, match="given 5 inputs; allowed 6"):
        GaugeForce("Dev1/ai0:4", GaugeCalibration(MATRIX.tolist()))
    assert card.closed


def microseconds_after_a_step(late_us):
    """Time from a step of the tank to the end of a wait for it, in us."""
    device, start = HostClockedRig(SimulatedRig(BenchTank())), time.monotonic_ns()

    def tick():
        device.tick((time.monotonic_ns() - start) // 1000)

    while time.monotonic_ns() - start < 1000 * late_us:
        pass
    for _ in range(5):
        tick()
        time.sleep(2e-3)
    due = device.on_step(time.monotonic() + 0.01)
    while time.monotonic() < due + 1e-4:
        tick()
    return (device.rig.reached_us - (1e6 * due - 1e-3 * start)) % STEP


@pytest.mark.parametrize("late_us", [0, 79, 921])
def test_a_simulated_record_waits_only_for_its_own_step(late_us):
    """The tank's steps begin at the first tick, at any time.

    Other programs can delay one attempt. A wrong wait would fail in all four.
    """
    assert any(microseconds_after_a_step(late_us) < 50.0 for _ in range(4))
