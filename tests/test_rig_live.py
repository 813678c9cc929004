"""Streams put together as they come: what was set and read at the same instant."""

import numpy as np
import pytest

from rig.columns import Analogue
from rig.live import LiveStream
from rig.messages import Reading

ZERO_NS = 10**12


class Wire:
    """Counts commands as the manifold's driver does."""

    seq = 0

    def set(self, pressures):
        self.seq += 1
        return self.seq


def stream(**settings):
    found = LiveStream(**settings)
    found.manifold = Wire()
    return found


def reading(i, command=0, p=(0, 0, 0, 0), tip=0):
    return Reading(i, 2000 * i, 2, command, (*p, 600_000, tip, 0, 0))


def arrives(live, i, late_ms=0.2, **content):
    live.reading(ZERO_NS + int(2e6 * i + 1e6 * late_ms), reading(i, **content))


def test_each_reading_has_the_pressures_that_the_manifold_followed_then():
    live = stream()
    first, second = live.set((100.0, 0.0, 0.0, 30.0)), live.set((0.0, 50.0, 20.0, 0.0))
    for i, command in enumerate((0, first, first, second)):
        arrives(live, i, command=command, p=(10 * i, 1, 0, 5))
    found = live.take()
    assert found.device_s == pytest.approx(2e-3 * np.arange(4))
    assert found.set_pressure.tolist() == [[0.0, 100.0, 100.0, -50.0], [0.0, -30.0, -30.0, 20.0]]
    assert found.measured[0].tolist() == [-1.0, 9.0, 19.0, 29.0]
    assert found.measured[1].tolist() == [-5.0] * 4 and np.isnan(found.measured[2:]).all()
    assert len(live.take().device_s) == 0


def test_a_voltage_is_a_tip():
    live = stream(analogue=(Analogue("tip_m", 1, 0.1, 0.5),))
    arrives(live, 0, tip=700_000)
    assert live.take().measured[4] == pytest.approx([0.02])


def test_forces_are_those_of_the_readings_time_and_are_waited_for():
    """Readings arrive with delays of their own; the clock tells when they were due."""
    live = stream(has_force=True)
    late = np.random.default_rng(0).uniform(0.0, 5.0, 100)
    late[::7] = 0.0
    for i in range(100):
        arrives(live, i, late_ms=late[i])
        live.force(ZERO_NS + int(2e6 * i + 1e6), 3.0 * (i + 0.5), -1.0 * (i + 0.5))
    found = live.take()
    n = len(found.device_s)
    assert 95 <= n < 100  # the last ones arrived after the latest force sample
    assert found.measured[2, 1:] == pytest.approx(3.0 * np.arange(1, n), abs=0.05)
    assert found.measured[3, 1:] == pytest.approx(-1.0 * np.arange(1, n), abs=0.05)


def test_a_force_sensor_that_falls_silent_is_not_waited_for():
    live = stream(has_force=True)
    live.force(ZERO_NS, 1.0, 1.0)
    for i in range(60):
        arrives(live, i)
    found = live.take()
    assert len(found.device_s) > 30 and np.isnan(found.measured[2, 5:]).all()
