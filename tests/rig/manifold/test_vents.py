"""The simulated manifold vents at every end of a trial: a finish, an error, a signal, a kill."""

import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from rig.chambers import SLIDER
from rig.errors import RigError
from rig.manifold.driver import Manifold
from rig.manifold.limits import PressureLimits
from rig.manifold.serial_port import PortLost, open_port
from rig.protocol.messages import Event, ManifoldState, decode_frame
from rig.scheduling import real_time_priority
from rig.simulated.rig import LineFaults, SimulatedRig
from rig.simulated.tank import BenchTank
from rig.simulated.terminal import serve_in_thread
from rig.trial.capture import ManifoldSinks, PlannedTrial, SwitchableSink, TrialTiming, record_trial
from rig.trial.waveform import ChamberDrive
from tests.support.data import ROOT
from tests.support.rig_experiment import EXPERIMENT, HANDLES_CTRL_C

VENT_WITHIN = 0.15
LIMITS = PressureLimits.of([250e3], SLIDER)
QUICK = TrialTiming(quiet=0.2, after=0.1, fade=0.0)
DRIVE = ChamberDrive("square", 5.0, 200e3)


class WatchedRig:
    """A simulated rig that notes the time of the last received bytes, and when it vents."""

    def __init__(self, faults=LineFaults()):
        self.rig = SimulatedRig(BenchTank(), faults=faults)
        self.vented, self.armed, self.received = 0, threading.Event(), 0
        self.highest = 0

    def feed(self, piece, now_us):
        self.received = time.monotonic_ns()
        return self._observe(self.rig.feed(piece, now_us))

    def tick(self, now_us):
        return self._observe(self.rig.tick(now_us))

    def _observe(self, sent):
        pressures = self.rig.core.set_pressures
        if pressures is not None and any(pressures):
            self.highest = max(self.highest, *pressures)
            self.armed.set()
            self.vented = 0
        elif pressures is None and self.armed.is_set() and not self.vented:
            self.vented = time.monotonic_ns()
        return sent

    def fail_in_drive(self, faults):
        """Returns a `watch` of a trial that brings the faults 0.3 s after the drive's start."""

        def fail(phase, t):
            if phase == "drive" and t > 0.3:
                self.rig.faults = faults

        return fail

    def vent_time(self, patience=5.0):
        """Waits for the vent and returns its time [ns]."""
        end = time.monotonic() + patience
        while not self.vented and time.monotonic() < end:
            time.sleep(0.002)
        assert self.vented, "the rig never vented"
        return self.vented


@pytest.fixture(autouse=True)
def before_other_tests():
    """Tests that run in parallel must not delay the host's commands until the rig vents."""
    with real_time_priority():
        yield


@pytest.fixture
def device():
    watched = WatchedRig()
    with serve_in_thread(watched) as served:
        yield watched, served


def start_run(port, tmp_path, duration):
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
    child = start_run(served.path, tmp_path, 0.6)
    assert child.wait(60.0) == 0
    assert watched.rig.core.state == ManifoldState.READY and watched.highest == 200_000
    assert (tmp_path / "out" / "a.csv").exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interrupted_trial_vents(device, tmp_path, number):
    watched, served = device
    child = start_run(served.path, tmp_path, 60.0)
    assert watched.armed.wait(60.0)
    time.sleep(0.3)
    sent = time.monotonic_ns()
    child.send_signal(number)
    assert watched.vent_time() - sent <= VENT_WITHIN * 1e9
    assert watched.rig.core.state == ManifoldState.READY
    assert child.wait(20.0) == 130


def test_a_killed_trial_vents(device, tmp_path):
    watched, served = device
    child = start_run(served.path, tmp_path, 60.0)
    assert watched.armed.wait(60.0)
    time.sleep(0.3)
    sent = time.monotonic_ns()
    child.kill()
    assert watched.vent_time() - sent <= VENT_WITHIN * 1e9
    assert watched.rig.core.state == ManifoldState.FAULT
    child.wait(20.0)


def run_trial(port, tmp_path, duration=60.0, watch=lambda phase, t: None):
    """Records a trial in this process."""
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
        run_trial(served.path, tmp_path, watch=fail)
    assert watched.vent_time() - watched.received < VENT_WITHIN * 1e9
    assert watched.rig.core.state == ManifoldState.READY


def test_an_unplugged_manifold_vents_and_the_error_names_the_port(tmp_path):
    watched = WatchedRig()
    with serve_in_thread(watched) as served:
        start = time.monotonic_ns()

        def unplug():
            watched.armed.wait(20.0)
            time.sleep(0.2)
            served.unplug()

        hand = threading.Thread(target=unplug)
        hand.start()
        with pytest.raises(PortLost, match="the port is gone") as failure:
            run_trial(served.path, tmp_path)
        hand.join()
    assert getattr(failure.value, "__notes__", []) == []  # the message does not come twice
    # The manifold still has power: its loop continues without the line.
    while not watched.vented and time.monotonic_ns() - start < 20e9:
        watched.tick((time.monotonic_ns() - start) // 1000)
        time.sleep(0.001)
    assert watched.rig.core.state == ManifoldState.FAULT and watched.vented


def test_a_manifold_that_resets_ends_the_trial(tmp_path):
    watched = WatchedRig()
    with serve_in_thread(watched) as served, pytest.raises(RigError, match="it has reset"):
        run_trial(served.path, tmp_path, watch=watched.fail_in_drive(LineFaults(reset_at=0.0)))
    assert watched.rig.core.state == ManifoldState.BOOT


def test_a_host_without_readings_stops_the_trial(tmp_path):
    """The manifold receives commands, but none of its messages arrive, not even its last Ack."""
    watched = WatchedRig()
    silence = watched.fail_in_drive(LineFaults(silent=(0.0, 1e9)))
    with serve_in_thread(watched) as served:
        with pytest.raises(RigError, match="no reading for 0.5 s") as failure:
            run_trial(served.path, tmp_path, watch=silence)
        assert watched.rig.core.state == ManifoldState.READY
    assert any("did not confirm the stop" in note for note in failure.value.__notes__)


def test_a_vent_whose_reason_is_lost_on_the_line_is_noticed(tmp_path):
    class WithoutEvents(WatchedRig):
        """A rig whose events never arrive."""

        def _observe(self, sent):
            wire = b"".join(frame + b"\0" for frame in super()._observe(sent).split(b"\0")[:-1]
                            if not isinstance(decode_frame(frame), Event))  # fmt: skip
            return wire

    watched = WithoutEvents()

    def raise_pressure(phase, t):
        if phase == "drive" and t > 0.3:
            watched.rig.tank._p[0] = 400e3

    with serve_in_thread(watched) as served, pytest.raises(RigError, match="its readings show"):
        run_trial(served.path, tmp_path, watch=raise_pressure)
    assert watched.rig.core.state == ManifoldState.FAULT


def test_a_manifold_on_a_dead_line_is_never_armed(tmp_path):
    """The line damages every byte to the manifold."""
    watched = WatchedRig(LineFaults(flipped=1.0))
    with serve_in_thread(watched) as served, pytest.raises(RigError, match="no manifold answers"):
        run_trial(served.path, tmp_path)
    assert watched.highest == 0


def test_a_pressure_above_the_limit_is_never_sent(device, tmp_path):
    watched, served = device
    switches, sent = ManifoldSinks(SwitchableSink(), SwitchableSink()), []
    switches.sent.to = lambda at, piece: sent.append(piece)
    with Manifold(open_port(served.path), *switches) as manifold:
        manifold.configure(LIMITS)
        manifold.arm()
        before = len(sent)
        for wrong in ((250e3 + 1, 0, 0, 0), (0, float("nan"), 0, 0), (0, 0, -1.0, 0), (0, 0, 0)):
            with pytest.raises(RigError, match="given .*allowed"):
                manifold.set(wrong)
        assert len(sent) == before
        manifold.set((250e3, 0, 0, 0))
        assert len(sent) == before + 1
        # Without this wait, the stop may arrive in the same piece.
        assert watched.armed.wait(1.0)
    assert watched.highest == 250_000


def test_a_trial_above_the_limit_does_not_begin(device, tmp_path):
    watched, served = device
    switches = ManifoldSinks(SwitchableSink(), SwitchableSink())
    with Manifold(open_port(served.path), *switches) as manifold:
        trial = PlannedTrial("a", ChamberDrive("sine", 1.0, 250e3, ratios=(1.0, 1.01)), 1.0)
        with pytest.raises(RigError, match="rear_left: given 252500 Pa; allowed 0 to its limit"):
            record_trial(trial, manifold, switches, {}, tmp_path / "a.h5", LIMITS, {}, QUICK)
    assert not (tmp_path / "a.h5").exists() and watched.highest == 0
