"""Every way out of a trial vents, as the simulated manifold sees it."""

import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from rig.errors import RigError
from rig.manifold.driver import Manifold
from rig.manifold.limits import PressureLimits
from rig.manifold.serial_port import PortLost, open_port
from rig.protocol.messages import Event, ManifoldState, decode_frame
from rig.scheduling import real_time_priority
from rig.simulated.rig import LineFaults, SimulatedRig
from rig.simulated.tank import BenchTank
from rig.simulated.terminal import in_thread
from rig.trial.capture import ManifoldSinks, PlannedTrial, SwitchableSink, TrialTiming, record_trial
from rig.trial.waveform import SegmentDrive
from tests.support.data import ROOT
from tests.support.rig_experiment import EXPERIMENT, HANDLES_CTRL_C

WITHIN = 0.15
LIMITS = PressureLimits.of([250e3])
QUICK = TrialTiming(quiet=0.2, after=0.1, fade=0.0)
DRIVE = SegmentDrive("square", 5.0, 200e3)


class Watched:
    """A simulated rig that notes when it was last told something, and when it vents."""

    def __init__(self, faults=LineFaults()):
        self.rig = SimulatedRig(BenchTank(), faults=faults)
        self.vented, self.armed, self.heard = 0, threading.Event(), 0
        self.highest = 0

    def feed(self, piece, now_us):
        self.heard = time.monotonic_ns()
        return self._look(self.rig.feed(piece, now_us))

    def tick(self, now_us):
        return self._look(self.rig.tick(now_us))

    def _look(self, said):
        pressures = self.rig.core.set_pressures
        if pressures is not None and any(pressures):
            self.highest = max(self.highest, *pressures)
            self.armed.set()
            self.vented = 0
        elif pressures is None and self.armed.is_set() and not self.vented:
            self.vented = time.monotonic_ns()
        return said

    def vents(self, patience=5.0):
        """When it vented [ns]."""
        end = time.monotonic() + patience
        while not self.vented and time.monotonic() < end:
            time.sleep(0.002)
        assert self.vented, "it never vented"
        return self.vented


@pytest.fixture(autouse=True)
def first_of_all():
    """Other tests beside these must not be taken for a host that fell silent."""
    with real_time_priority():
        yield


@pytest.fixture
def device():
    watched = Watched()
    with in_thread(watched) as served:
        yield watched, served


def start(port, tmp_path, duration):
    path = tmp_path / "experiment.toml"
    path.write_text(EXPERIMENT.format(duration=duration))
    command = [sys.executable, "-c", HANDLES_CTRL_C, "rig", "run", str(path)]

    return subprocess.Popen(
        [*command, "--port", port, "--out", str(tmp_path / "out")],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip


def test_a_finished_trial_vents(device, tmp_path):
    watched, served = device
    child = start(served.path, tmp_path, 0.6)
    assert child.wait(60.0) == 0
    assert watched.rig.core.state == ManifoldState.READY and watched.highest == 200_000
    assert (tmp_path / "out" / "a.csv").exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interrupted_trial_vents(device, tmp_path, number):
    watched, served = device
    child = start(served.path, tmp_path, 60.0)
    assert watched.armed.wait(60.0)
    time.sleep(0.3)
    told = time.monotonic_ns()
    child.send_signal(number)
    assert watched.vents() - told <= WITHIN * 1e9
    assert watched.rig.core.state == ManifoldState.READY
    assert child.wait(20.0) == 130


def test_a_killed_trial_vents(device, tmp_path):
    watched, served = device
    child = start(served.path, tmp_path, 60.0)
    assert watched.armed.wait(60.0)
    time.sleep(0.3)
    told = time.monotonic_ns()
    child.kill()
    assert watched.vents() - told <= WITHIN * 1e9
    assert watched.rig.core.state == ManifoldState.FAULT
    child.wait(20.0)


def recorded(port, tmp_path, duration=60.0, watch=lambda phase, t: None):
    """A trial in this process."""
    switches = ManifoldSinks(SwitchableSink(), SwitchableSink())
    with Manifold(open_port(port), *switches) as manifold:
        trial = PlannedTrial("a", DRIVE, duration)
        path = tmp_path / "a.h5"
        return record_trial(trial, manifold, switches, {}, path, LIMITS, {}, QUICK, watch)


def test_an_error_in_the_program_vents(device, tmp_path):
    watched, served = device

    def fail(phase, t):
        if phase == "drive" and t > 0.3:
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        recorded(served.path, tmp_path, watch=fail)
    assert watched.vents() - watched.heard < WITHIN * 1e9
    assert watched.rig.core.state == ManifoldState.READY


def test_an_unplugged_manifold_vents_and_the_port_is_said_to_be_gone(tmp_path):
    watched = Watched()
    with in_thread(watched) as served:
        begun = time.monotonic_ns()

        def unplug():
            watched.armed.wait(20.0)
            time.sleep(0.2)
            served.unplug()

        hand = threading.Thread(target=unplug)
        hand.start()
        with pytest.raises(PortLost, match="the port is gone") as told:
            recorded(served.path, tmp_path)
        hand.join()
    assert getattr(told.value, "__notes__", []) == []  # said once
    # It still has its power: its loop goes on, without a line.
    while not watched.vented and time.monotonic_ns() - begun < 20e9:
        watched.tick((time.monotonic_ns() - begun) // 1000)
        time.sleep(0.001)
    assert watched.rig.core.state == ManifoldState.FAULT and watched.vented


def test_a_manifold_that_resets_ends_the_trial(tmp_path):
    watched = Watched(LineFaults(reset_at=1.0))
    with in_thread(watched) as served, pytest.raises(RigError, match="it has reset"):
        recorded(served.path, tmp_path)
    assert watched.rig.core.state == ManifoldState.BOOT


def test_who_does_not_see_what_it_drives_stops(tmp_path):
    """The manifold hears, but nothing comes back: not even that it has stopped."""
    watched = Watched(LineFaults(silent=(1.0, 1e9)))
    with in_thread(watched) as served:
        with pytest.raises(RigError, match="no reading for 0.5 s") as told:
            recorded(served.path, tmp_path)
        assert watched.rig.core.state == ManifoldState.READY
    assert any("stop was not confirmed" in note for note in told.value.__notes__)


def test_a_vent_whose_reason_is_lost_on_the_line_is_noticed(tmp_path):
    class Mute(Watched):
        """Its events never arrive."""

        def _look(self, said):
            wire = b"".join(frame + b"\0" for frame in super()._look(said).split(b"\0")[:-1]
                            if not isinstance(decode_frame(frame), Event))  # fmt: skip
            return wire

    watched = Mute()

    def leak_out(phase, t):
        if phase == "drive" and t > 0.3:
            watched.rig.tank._p[0] = 400e3

    with in_thread(watched) as served, pytest.raises(RigError, match="its readings say so"):
        recorded(served.path, tmp_path, watch=leak_out)
    assert watched.rig.core.state == ManifoldState.FAULT


def test_a_line_that_is_dead_vents(tmp_path):
    """Every byte to the manifold is damaged from the start: nothing is ever armed."""
    watched = Watched(LineFaults(flipped=1.0))
    with in_thread(watched) as served, pytest.raises(RigError, match="no manifold answers"):
        recorded(served.path, tmp_path)
    assert watched.highest == 0


def test_a_pressure_above_the_limit_is_never_on_the_wire(device, tmp_path):
    watched, served = device
    switches, went = ManifoldSinks(SwitchableSink(), SwitchableSink()), []
    switches.sent.to = lambda at, piece: went.append(piece)
    with Manifold(open_port(served.path), *switches) as manifold:
        manifold.configure(LIMITS)
        manifold.arm()
        before = len(went)
        for wrong in ((250e3 + 1, 0, 0, 0), (0, float("nan"), 0, 0), (0, 0, -1.0, 0), (0, 0, 0)):
            with pytest.raises(RigError, match="given .*allowed"):
                manifold.set(wrong)
        assert len(went) == before
        manifold.set((250e3, 0, 0, 0))
        assert len(went) == before + 1
        # Else the stop may come in the same piece.
        assert watched.armed.wait(1.0)
    assert watched.highest == 250_000


def test_a_trial_above_the_limit_does_not_begin(device, tmp_path):
    watched, served = device
    switches = ManifoldSinks(SwitchableSink(), SwitchableSink())
    with Manifold(open_port(served.path), *switches) as manifold:
        trial = PlannedTrial("a", SegmentDrive("sine", 1.0, 250e3, rear_ratio=1.01), 1.0)
        with pytest.raises(RigError, match="rear_left: given 252500 Pa; allowed 0 to its limit"):
            record_trial(trial, manifold, switches, {}, tmp_path / "a.h5", LIMITS, {}, QUICK)
    assert not (tmp_path / "a.h5").exists() and watched.highest == 0
