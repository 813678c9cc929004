"""The live stream combines set and measured values at each reading."""

import numpy as np
import pytest

from rig.chambers import SLIDER, ChamberLayout, PneumaticActuator
from rig.protocol.messages import Follows, Reading
from rig.recording.table import AnalogueSensor
from rig.trial.live_stream import LiveStream

ZERO_NS = 10**12


class CommandCounter:
    """Numbers commands as the manifold's driver does."""

    seq = 0

    def set(self, pressures):
        self.seq += 1
        return self.seq


def stream(layout=SLIDER, **settings):
    found = LiveStream(layout, **settings)
    found.manifold = CommandCounter()
    return found


def reading(i, command=0, p=(0, 0, 0, 0), tip=0):
    return Reading(i, 2000 * i, 2, command, (*p, 600_000, tip, 0, 0))


def arrives(live, i, late_ms=0.2, **content):
    live.reading(ZERO_NS + int(2e6 * i + 1e6 * late_ms), reading(i, **content))


def test_after_a_restart_of_the_manifold_set_pressures_start_from_zero():
    live = stream()
    command = live.set((100.0, 0.0, 0.0, 0.0))
    follows(live, 1, 900e3, (100, 0, 0, 0))
    live.reading(ZERO_NS, Reading(7, 900_001_000, 2, command, (0,) * 8))
    live.reading(ZERO_NS, Reading(0, 0, 0, 0, (0,) * 8))  # restarted: no set pressures
    for i in range(1, 4):
        arrives(live, i)
    follows(live, 0, 7.0, (100, 0, 0, 0))
    arrives(live, 4, command=command)
    found = live.take()
    assert found.device_s == pytest.approx([2e-3, 4e-3, 6e-3, 8e-3])
    assert found.set_pressure[0] == pytest.approx([0.0, 0.0, 0.0, 50.0])


def test_readings_are_used_only_while_the_valves_follow_set_pressures():
    live = stream()
    arrives(live, 0, p=(50, 0, 0, 0))
    live.reading(ZERO_NS, Reading(1, 2000, 1, 0, (40,) + (0,) * 7))  # vented
    assert live.take().measured[0].tolist() == [50.0]


def follows(live, number, ms, p):
    live.follows(Follows(number, round(1000 * ms), p))


def test_each_reading_has_the_mean_set_pressure_since_the_previous_reading():
    live = stream()
    first, second = live.set((100.0, 0.0, 0.0, 30.0)), live.set((0.0, 50.0, 20.0, 0.0))
    arrives(live, 0, p=(0, 1, 0, 5))
    follows(live, 1, 1.5, (100, 0, 0, 30))
    arrives(live, 1, command=first, p=(10, 1, 0, 5))
    follows(live, 2, 2.5, (0, 50, 20, 0))
    follows(live, 3, 3.0, (100, 0, 0, 30))
    assert live.take().set_pressure.tolist() == [[0.0, 25.0], [0.0, -7.5]]
    arrives(live, 2, command=first, p=(20, 1, 0, 5))
    follows(live, 4, 4.2, (0, 50, 20, 0))
    arrives(live, 4, command=second, p=(30, 1, 0, 5))  # one reading is lost
    found = live.take()
    assert found.device_s == pytest.approx([4e-3, 8e-3])
    assert found.set_pressure[0] == pytest.approx([(75 - 0.25 * 50), 5 - 0.95 * 50])
    assert found.set_pressure[1] == pytest.approx([-0.75 * 30 + 0.25 * 20, -1.5 + 0.95 * 20])
    assert found.measured[0].tolist() == [19.0, 29.0]
    assert found.measured[1].tolist() == [-5.0] * 2 and np.isnan(found.measured[2:]).all()
    assert len(live.take().device_s) == 0


def test_the_stream_has_the_actuators_of_the_robot():
    layout = ChamberLayout((PneumaticActuator("head"), PneumaticActuator("fin", "right")))
    live = stream(layout, analogue=(AnalogueSensor("tip_m", 1, 0.1, 0.0),))
    assert live.columns == ("p_head_Pa", "p_fin_Pa", "thrust_N", "recoil_N", "tip_m")
    command = live.set((100.0, 0.0, 30.0))
    for i in range(2):
        arrives(live, i, command=command, p=(9, 1, 5), tip=700_000)
    found = live.take()
    assert found.set_pressure.tolist() == [[100.0, 100.0], [-30.0, -30.0]]
    assert found.measured[:2].tolist() == [[8.0, 8.0], [-5.0, -5.0]]
    assert found.measured[4] == pytest.approx([0.07, 0.07])


def test_a_lost_change_is_inferred_from_the_command_number_of_a_reading():
    live = stream()
    first, second = live.set((100.0, 0.0, 0.0, 30.0)), live.set((0.0, 50.0, 20.0, 0.0))
    for i, command in enumerate((0, first, first, second, second)):
        arrives(live, i, command=command)
    found = live.take()
    assert found.set_pressure[0] == pytest.approx([0.0, 50.0, 100.0, 25.0, -50.0])
    assert found.set_pressure[1] == pytest.approx([0.0, -15.0, -30.0, -5.0, 20.0])


def test_a_voltage_is_converted_to_the_tip():
    live = stream(analogue=(AnalogueSensor("tip_m", 1, 0.1, 0.5),))
    arrives(live, 0, tip=700_000)
    assert live.take().measured[4] == pytest.approx([0.02])


def test_forces_are_interpolated_at_the_times_of_the_readings():
    """Both arrive with independent delays; their clocks give the scheduled times."""
    live = stream(has_force=True)
    late, force_late = np.random.default_rng(0).uniform(0.0, 5.0, (2, 100))
    late[::7] = force_late[::9] = 0.0
    for i in range(100):
        arrives(live, i, late_ms=late[i])
        live.force(ZERO_NS + int(2e6 * i + 1e6 * force_late[i]), 2e-3 * i + 7.0, 3.0 * i, -1.0 * i)
    found = live.take()
    n = len(found.device_s)
    assert 98 <= n <= 100
    assert found.measured[2, 1:] == pytest.approx(3.0 * np.arange(1, n), abs=0.05)
    assert found.measured[3, 1:] == pytest.approx(-1.0 * np.arange(1, n), abs=0.05)


def test_a_reading_waits_for_the_force_of_its_time():
    live = stream(has_force=True)
    for i in range(5):
        live.force(ZERO_NS + int(2e6 * i), 2e-3 * i, 3.0 * i, 0.0)
        arrives(live, i, late_ms=0.0)
    assert len(live.take().device_s) == 5
    arrives(live, 5, late_ms=0.0)
    arrives(live, 6, late_ms=0.0)
    assert len(live.take().device_s) == 0
    live.force(ZERO_NS + 13_000_000, 11e-3, 16.5, 0.0)
    found = live.take()
    assert found.device_s == pytest.approx([10e-3]) and found.measured[2] == pytest.approx([15.0])


def test_lost_forces_are_not_interpolated():
    live = stream(has_force=True)
    for i in range(40):
        arrives(live, i, late_ms=0.0)
        if not 10 <= i < 20:
            live.force(ZERO_NS + int(2e6 * i), 2e-3 * i, 1.0 * i, 0.0)
    thrust = live.take().measured[2]
    assert np.isnan(thrust[10:20]).all() and np.isfinite(thrust[:10]).all()
    assert np.isfinite(thrust[21:39]).all()


def test_forces_are_kept_when_a_smaller_delay_shifts_the_clock():
    live = stream(has_force=True)
    read = 0
    for i in range(200):
        arrives(live, i, late_ms=20.0 if i < 100 else 0.0)
        live.force(ZERO_NS + int(2e6 * i), 2e-3 * i, 1.0 * i, 0.0)
        found = live.take()
        read += int(np.isfinite(found.measured[2]).sum())
    assert read >= 180


def test_readings_do_not_wait_for_a_silent_force_sensor():
    live = stream(has_force=True)
    live.force(ZERO_NS, 0.0, 1.0, 1.0)
    for i in range(60):
        arrives(live, i)
    found = live.take()
    assert len(found.device_s) > 30 and np.isnan(found.measured[2, 5:]).all()
