"""A pause ends when the sensors are at rest; simulated devices follow commands in time."""

import numpy as np
import pytest

from rig.protocol.messages import Arm, ManifoldState, Reading, SetLimits, SetPressures, encode_frame
from rig.recording.table import AnalogueSensor, _motion_findings
from rig.simulated.manifold import ManifoldCore
from rig.simulated.rig import LineFaults, SimulatedRig
from rig.simulated.tank import TankState
from rig.trial.settling import MAX_REST_RANGE, WINDOW, Stillness, sensor_noise

TIP, RANGE = AnalogueSensor("tip_m", 1, 0.1), 0.08


def reading(tip):
    return Reading(0, 0, 1, 0, (0, 0, 0, 0, 600_000, round(1e6 * tip / 0.1), 0, 0))


def rest_time(swing, noise=0.0, longest=200.0, sensors=(TIP,), ranges=None):
    """Returns the time [s] until a tip that moves by `swing(t)` [m] counts as at rest."""
    still = Stillness(sensors, {"tip_m": RANGE} if ranges is None else ranges, {"tip_m": noise})
    rng = np.random.default_rng(0)
    for t in np.arange(0.0, longest, 0.05):
        if still.reached:
            return t
        still.add(float(t), reading(swing(t) + noise * rng.normal()))
    return np.inf


def test_rest_is_detected_after_a_swing_has_decayed():
    assert rest_time(lambda t: 0.0) == pytest.approx(WINDOW, abs=0.3)
    end = rest_time(lambda t: 0.01 * np.exp(-t / 5.0) * np.cos(3.0 * t))
    # The range is twice the amplitude at the beginning of the window.
    at = 5.0 * np.log(2 * 0.01 / (MAX_REST_RANGE * RANGE))
    assert at - 1.0 < end < at + WINDOW + 1.0
    assert rest_time(lambda t: 1e-3 * np.cos(3.0 * t)) == np.inf


def test_noise_alone_is_rest_and_a_swing_is_not():
    assert rest_time(lambda t: 0.0, noise=2e-3) < 10.0
    for frequency in (0.5, 2.0, 3.0, 6.0):
        turning = 2 * np.pi * frequency
        assert rest_time(lambda t, w=turning: 0.01 * np.cos(w * t), noise=2e-3) == np.inf


def test_a_gap_in_the_readings_is_not_rest():
    still = Stillness((TIP,), {"tip_m": RANGE}, {})
    for t, tip in ((0.0, 0.01), (0.05, 0.01), (2.45, -0.01)):
        still.add(t, reading(tip))
    assert not still.reached


def test_without_a_sensor_there_is_no_wait():
    assert rest_time(lambda t: t, sensors=()) == 0.0
    assert rest_time(lambda t: t, ranges={"tip_m": 0.0}) == 0.0


def test_motion_before_the_drive_is_a_finding():
    t = np.arange(500) / 500.0
    drive = 0.04 * np.sin(20 * t)
    noise = 1e-3 * np.random.default_rng(0).normal(size=500)
    assert (
        _motion_findings("tip_m", noise, drive, 1e-3)
        == _motion_findings("tip_m", noise, noise, 1e-3)
        == ()
    )
    (finding,) = _motion_findings("tip_m", 2e-3 * np.sin(6 * t) + noise, drive, 1e-3)
    assert "tip_m was not at rest before the drive" in finding and "longer pause" in finding


class SetPressureLog:
    """A tank that only stores its set pressures."""

    def __init__(self):
        self.sets = []

    def advance(self, set_pressures, seconds):
        self.sets.append(set_pressures)
        return TankState((0.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0, 0.0)


class NumberCore(ManifoldCore):
    """A manifold that sets all chambers to the number that it receives."""

    set_pressures = None

    def feed(self, piece, now_us):
        self.set_pressures = (int(piece),) * 4
        return b""

    def tick(self, now_us, channels):
        return b""


def test_a_delayed_simulated_tank_follows_each_command_from_its_arrival():
    """Two commands arrive while the tank is 5 ms late; earlier steps keep the previous command."""
    tank = SetPressureLog()
    rig = SimulatedRig(tank, NumberCore())
    rig.tick(0)
    rig.feed(b"1000", 200)
    rig.tick(1500)
    rig.feed(b"2000", 4300)
    rig.feed(b"3000", 6000)
    rig.tick(8000)
    first = tank.sets[1:]
    assert first[0] == (800,) * 4  # vented until 0.2 ms
    assert first[1:4] == [(1000,) * 4] * 3
    assert first[4] == (1700,) * 4  # 0.3 ms of 1000, 0.7 ms of 2000
    assert first[5] == (2000,) * 4 and first[6:] == [(3000,) * 4] * 2


def test_a_reset_vents_the_simulated_tank():
    tank = SetPressureLog()
    rig = SimulatedRig(tank, NumberCore(), LineFaults(reset_at=0.005), NumberCore)
    rig.tick(0)
    rig.feed(b"1000", 200)
    for now in range(0, 10_000, 500):
        rig.tick(now)
    assert tank.sets[3] == (1000,) * 4 and tank.sets[-1] is None and len(tank.sets) == 10


def test_a_stalled_simulated_manifold_does_not_trip_its_watchdog():
    """A command waits while the program stalls for 200 ms."""
    rig = SimulatedRig(SetPressureLog())
    for message in (SetLimits(1, (100_000,) * 4), Arm(2), SetPressures(3, (1, 1, 1, 1))):
        rig.feed(encode_frame(message), 0)
    for now in range(0, 39_000, 1000):
        rig.tick(now)
    rig.feed(encode_frame(SetPressures(4, (2, 2, 2, 2))), 238_000)
    for now in range(238_000, 290_000, 1000):
        rig.tick(now)
        if now == 250_000:
            rig.feed(encode_frame(SetPressures(5, (3, 3, 3, 3))), now)
    assert rig.core.state == ManifoldState.ARMED and rig.core.set_pressures == (3, 3, 3, 3)
    # The watchdog still detects a silent host, after the stalled time is made up.
    rig.tick(600_000)
    assert rig.core.state == ManifoldState.FAULT


class ReadingSource:
    """A manifold whose latest reading is new at each access."""

    def __init__(self, tip):
        self._tip, self._seq = tip, 0

    @property
    def latest(self):
        self._seq += 1
        return reading(self._tip(2e-3 * self._seq))._replace(seq=self._seq)


def test_the_noise_estimate_is_independent_of_a_swing():
    rng = np.random.default_rng(0)

    def found(white):
        swing = ReadingSource(lambda t: 0.01 * np.cos(20 * t) + white * rng.normal())
        return sensor_noise(swing, (TIP,), 200)["tip_m"]

    assert found(0.0) < 1e-5
    assert found(3e-4) == pytest.approx(3e-4, rel=0.2)
    assert sensor_noise(ReadingSource(lambda t: 0.0), ()) == {}
