"""The manifold's driver on a pseudo-terminal, and the files of a recorded trial."""

import json
import os
import time
from pathlib import Path

import numpy as np
import pytest

from rig.chambers import SLIDER, ChamberLayout, PneumaticActuator
from rig.errors import RigError
from rig.manifold.driver import Manifold
from rig.manifold.limits import PressureLimits
from rig.manifold.serial_port import open_port
from rig.protocol.messages import ManifoldState
from rig.recording.reader import read_recording
from rig.recording.table import AnalogueSensor, trial_columns
from rig.scheduling import real_time_priority
from rig.simulated.manifold import HARD_LIMIT, ManifoldCore
from rig.simulated.rig import TIP_PER_VOLT, LineFaults, SimulatedRig
from rig.simulated.tank import BenchTank
from rig.simulated.terminal import serve_in_thread
from rig.trial.capture import ManifoldSinks, PlannedTrial, SwitchableSink, TrialTiming
from rig.trial.player import command_times, play_drive
from rig.trial.session import RECORDINGS, Rig, run_trials
from rig.trial.waveform import ChamberDrive

LIMITS = PressureLimits.of([250e3], SLIDER)
QUICK = TrialTiming(quiet=0.3, after=0.1, fade=0.0)
TIP = AnalogueSensor("tip_m", 1, TIP_PER_VOLT)
THREE_PAIRS = ChamberLayout(tuple(PneumaticActuator(x) for x in ("head", "middle", "rear")))
ONE_CHAMBER = ChamberLayout((PneumaticActuator("fin", "right", 150e3, "P_Pa"),))


@pytest.fixture(autouse=True)
def before_other_tests():
    """Tests that run in parallel must not delay the host's commands until the rig vents."""
    with real_time_priority():
        yield


def simulated_rig(layout=SLIDER, faults=LineFaults(noise=100.0)):
    core = ManifoldCore((HARD_LIMIT,) * len(layout.names))
    return SimulatedRig(BenchTank(layout), core, faults)


def rig_on(port, layout=SLIDER, **changes):
    """Returns a `Rig` on `port`; use it within its manifold's context."""
    switches = ManifoldSinks(SwitchableSink(), SwitchableSink())
    manifold = Manifold(open_port(port), *switches)
    limits = PressureLimits.of([250e3], layout)
    return Rig(
        manifold, switches, limits, {}, {}, analogue=(TIP,), timing=QUICK, pause=0.05, **changes
    )


def run_on_simulated_rig(
    tmp_path, trials, faults=LineFaults(noise=100.0), settings=None, layout=SLIDER
):
    with serve_in_thread(simulated_rig(layout, faults)) as served:
        rig = rig_on(served.path, layout)
        with rig.manifold:
            return run_trials(trials, rig, tmp_path, settings or {})


def read_columns(path):
    return np.genfromtxt(path, delimiter=",", names=True)


DRIVES = {
    "two pairs": ChamberDrive("square", 2.0, 100e3, ratios=(1.0, 0.5), phases=(0.0, 0.25)),
    "three pairs": ChamberDrive(
        "square", 2.0, 100e3, (1.0, 0.8, 0.5), (0.0, 0.15, 0.3), (0.0, 2e4, 0.0),
        layout=THREE_PAIRS,
    ),
    "one chamber": ChamberDrive("square", 2.0, 100e3, layout=ONE_CHAMBER),
}  # fmt: skip


@pytest.mark.parametrize("drive", DRIVES.values(), ids=DRIVES)
def test_a_recorded_trial_has_the_chambers_pressures(drive, tmp_path):
    """The reference is the lag's exact solution for the set pressures that the valves followed."""
    layout = drive.layout
    (record,) = run_on_simulated_rig(tmp_path, [PlannedTrial("a", drive, 1.5)], layout=layout)
    found = read_columns(tmp_path / "a.csv")
    assert found.dtype.names == ("t_s", *layout.columns, "tip_m")
    assert record["readings_lost"] == record["frames_damaged"] == 0
    # Tests that run in parallel may delay the commands.
    assert [x for x in record["findings"] if "too busy" not in x] == []
    assert np.diff(found["t_s"]) == pytest.approx(2e-3, abs=2e-5)
    played = read_columns(tmp_path / "a.played.csv")
    fine = np.arange(0.0, 1.5, 1e-4)
    now = np.searchsorted(played["t_s"], fine, side="right") - 1
    assert played.dtype.names == ("t_s", *layout.set_columns)
    for index, (column, set_column) in enumerate(
        zip(layout.columns, layout.set_columns, strict=True)
    ):
        planned = np.array([drive.signed(t)[index] for t in fine])
        sets = played[set_column][now]
        assert np.ptp(sets) > 50e3
        # Edges are late by the commands' travel time; no other differences are allowed.
        assert np.mean(sets != planned) < 0.02
        p, expected = 0.0, []
        for p_set in sets:
            expected.append(p)
            p += 1e-4 / 0.05 * (p_set - p)
        error = found[column] - np.interp(found["t_s"], fine, expected)
        assert np.abs(error).max() < 0.01 * 100e3 and error.std() < 0.003 * 100e3
    tip, follows = [0.0], 1.0 - np.exp(-2e-3 / 0.02)
    for aim in 2e-7 * sum(found[column] for column in layout.columns)[1:]:
        tip.append(tip[-1] + follows * (aim - tip[-1]))
    assert found["tip_m"] == pytest.approx(np.array(tip), abs=3e-4)


def test_the_played_drive_is_recorded_to_a_fraction_of_a_millisecond(tmp_path):
    """The chambers followed the file's drive; the planned drive is up to 1 ms early."""
    drive = ChamberDrive("square", 2.0, 100e3, ratios=(1.0, 0.5), phases=(0.0, 0.25))
    run_on_simulated_rig(tmp_path, [PlannedTrial("a", drive, 1.5)], LineFaults())
    found, played = read_columns(tmp_path / "a.csv"), read_columns(tmp_path / "a.played.csv")
    assert played["t_s"][0] == 0.0 and played["t_s"][-1] == 1.5
    edges = drive.edges(1.5)
    late = played["t_s"][1:-1] - edges  # by the travel time, and by more on a busy computer
    assert np.all(late > 0.0) and np.all(late < 0.5 * np.diff(edges).min())
    for name, sets in (("p_front_Pa", "set_front_Pa"), ("p_rear_Pa", "set_rear_Pa")):
        p, now, expected = 0.0, 0.0, []
        changes = [*zip(played["t_s"][1:], played[sets], strict=False), (np.inf, 0.0)]
        for t in found["t_s"]:
            while changes[0][0] < t:
                until, a = changes.pop(0)
                p, now = a + (p - a) * np.exp(-(until - now) / 0.05), until
            a = changes[0][1]
            p, now = a + (p - a) * np.exp(-(t - now) / 0.05), t
            expected.append(p)
        # The bound is the change within 0.1 ms at an edge of 200 kPa.
        assert np.abs(found[name] - expected).max() < 2.0 * 100e3 * 1e-4 / 0.05


def test_after_a_lost_change_of_the_drive_the_planned_drive_is_used(tmp_path, monkeypatch):
    drive = PlannedTrial("a", ChamberDrive("square", 4.0, 100e3), 1.0)
    (tmp_path / "a.played.csv").write_text("left by an earlier run")
    original, lost = ManifoldCore._follows, []

    def skip_one(core, now_us):
        message = original(core, now_us)
        if message.number == 3:
            lost.append(message)
            core._changes += 1
            return message._replace(number=4)
        return message

    monkeypatch.setattr(ManifoldCore, "_follows", skip_one)
    (record,) = run_on_simulated_rig(tmp_path, [drive])
    assert lost and not (tmp_path / "a.played.csv").exists()
    assert any("the planned drive is used instead" in x for x in record["findings"])


def test_a_drive_decays_to_zero_after_its_trial():
    sent = []

    class Valves:
        def set(self, pressures):
            sent.append(pressures)
            return 0

    play_drive(Valves(), ChamberDrive("square", 5.0, 100e3), 0.2, 200.0, fade=0.2)
    amplitude = [max(p) for p in sent]
    # 1.1 s / 5 ms = 220.00000000000003, which must not add a command.
    assert command_times(ChamberDrive("sine", 5.0, 100e3), 1.1)[-1] < 1.0999
    assert len(sent) == 80 and amplitude[:40] == [100e3] * 40
    after = np.array(amplitude[40:])
    assert np.all(np.diff(after) < 0.0) and after[0] == 100e3 and after[-1] < 0.01 * 100e3
    assert after[20] == pytest.approx(50e3, rel=1e-6)


T = np.array([0.0, 0.1, 0.3])


def test_a_changed_recorded_drive_is_refused_by_its_samples(tmp_path):
    """A changed experiment file alone is no obstacle: its other trials may change."""

    def drive(last):
        return ChamberDrive(
            "recorded", times=T, recorded=np.array([[0.0, 0.0], [5e4, 0.0], [0.0, last]])
        )

    run_on_simulated_rig(
        tmp_path, [PlannedTrial("a", drive(1e4), 0.3)], settings={"experiment_sha256": "1"}
    )
    run_on_simulated_rig(
        tmp_path, [PlannedTrial("a", drive(1e4), 0.3)], settings={"experiment_sha256": "2"}
    )
    assert not list((tmp_path / RECORDINGS).glob("a.unfinished*"))
    with pytest.raises(RigError, match=r"other values of trial\.drive\.recorded_sha256; give"):
        run_on_simulated_rig(
            tmp_path, [PlannedTrial("a", drive(2e4), 0.3)], settings={"experiment_sha256": "1"}
        )


def test_an_interrupted_run_resumes_with_the_missing_trials(tmp_path):
    trials = [PlannedTrial(name, ChamberDrive("sine", 2.0, 50e3), 0.3) for name in "ab"]
    run_on_simulated_rig(tmp_path, trials[:1], settings={"x": (1, 2)})
    before = (tmp_path / RECORDINGS / "a.h5").stat().st_mtime_ns
    (tmp_path / RECORDINGS / "b.h5").write_bytes(b"half")
    records = run_on_simulated_rig(tmp_path, trials, settings={"x": (1, 2)})
    assert [x["trial"] for x in records] == ["a", "b"]
    assert (tmp_path / RECORDINGS / "a.h5").stat().st_mtime_ns == before
    assert (tmp_path / RECORDINGS / "b.unfinished-1.h5").read_bytes() == b"half"
    with pytest.raises(RigError, match="other values of x"):
        run_on_simulated_rig(tmp_path, trials, settings={"x": (1, 3)})
    for other in (
        ChamberDrive("sine", 2.0, 51e3),
        ChamberDrive("recorded", times=T, recorded=np.zeros((3, 2))),
    ):
        with pytest.raises(RigError, match=r"other values of trial\.drive\."):
            run_on_simulated_rig(tmp_path, [PlannedTrial("a", other, 0.3)], settings={"x": (1, 2)})
    # A repeated trial keeps the earlier recording and its record under another name.
    (tmp_path / "a.csv").unlink()
    run_on_simulated_rig(tmp_path, trials, settings={"x": (1, 2)})
    record = json.loads((tmp_path / RECORDINGS / "a.unfinished-1.json").read_text())
    assert record["trial"] == "a" and (tmp_path / RECORDINGS / "a.unfinished-1.h5").exists()


def test_a_run_of_an_earlier_version_is_resumed(tmp_path):
    """Records of earlier versions describe the drive of two pairs by `rear_ratio` and `phase`."""
    drive = ChamberDrive("sine", 2.0, 50e3, (1.0, 0.9), (0.0, 0.1))
    run_on_simulated_rig(tmp_path, [PlannedTrial("a", drive, 0.3)])
    path = tmp_path / RECORDINGS / "a.json"
    record = json.loads(path.read_text())
    record["drive"] = {
        "waveform": "sine", "frequency": 2.0, "amplitude": 50e3, "rear_ratio": 0.9, "phase": 0.1,
        "rise": 0.1,
    }  # fmt: skip
    path.write_text(json.dumps(record))
    run_on_simulated_rig(tmp_path, [PlannedTrial("a", drive, 0.3)])
    assert not list((tmp_path / RECORDINGS).glob("a.unfinished*"))
    for other in (
        ChamberDrive("sine", 2.0, 50e3, (1.0, 0.8), (0.0, 0.1)),
        ChamberDrive("sine", 2.0, 50e3, (1.0, 0.9), (0.0, 0.1), (0.0, 1e3)),
    ):
        with pytest.raises(RigError, match=r"other values of trial\.drive\.(ratios|biases)"):
            run_on_simulated_rig(tmp_path, [PlannedTrial("a", other, 0.3)])


def test_a_bad_line_loses_readings_and_the_record_reports_it(tmp_path):
    faults = LineFaults(flipped=1e-4, dropped=1e-4, inserted=1e-4)
    (record,) = run_on_simulated_rig(
        tmp_path, [PlannedTrial("a", ChamberDrive("sine", 2.0, 50e3), 1.0)], faults
    )
    assert record["readings_lost"] > 0 and record["frames_damaged"] > 0
    assert any("lost" in x for x in record["findings"])
    found = read_columns(tmp_path / "a.csv")
    gaps = np.round(np.diff(found["t_s"]) / 2e-3).astype(int)
    assert gaps.min() == 1 and gaps.sum() - len(gaps) <= record["readings_lost"]
    assert np.abs(found["p_front_Pa"]).max() < 51e3


def test_an_edge_close_to_a_regular_command_is_kept():
    """The edge is at 1.50000015 s, and a regular command is due at 1.5 s."""
    drive = ChamberDrive("square", 0.3333333, 1e5)
    times = command_times(drive, 2.0)
    switched = next(t for t in times if drive.signed(t)[0] < 0.0)
    assert switched - 0.5 / 0.3333333 < 1e-9 and np.diff(times).min() > 1e-6


def test_edges_of_a_square_wave_are_commanded_at_their_exact_times():
    drive = ChamberDrive("square", 4.8, 1e5, phases=(0.0, 0.15))
    times = command_times(drive, 1.0)
    for t in drive.edges(1.0):
        before, after = drive.signed(t - 1e-7), drive.signed(t)
        assert t == 0.0 or before != after or t == pytest.approx(0.15 / 4.8)
        assert np.abs(times - t).min() < 1e-9
    changes = [t for t in np.arange(1e-4, 1.0, 1e-4)
               if drive.signed(t) != drive.signed(t - 1e-4)]  # fmt: skip
    edges = drive.edges(1.0)
    assert all(np.abs(edges - t).min() < 1.01e-4 for t in changes) and len(changes) >= 18
    assert np.all(np.diff(times) > 0.0) and np.diff(times).max() <= 5e-3 + 1e-9


@pytest.mark.parametrize("waveform", ["square", "sine", "trapezoid"])
def test_waveforms_equal_those_of_the_simulator(waveform):
    import jax.numpy as jnp

    from slider_jax.actuation import SineWave, SquareWave, Trapezoid

    drive = ChamberDrive(waveform, 3.0, 2e5, ratios=(1.0, -0.6), phases=(0.0, 0.3), rise=0.2)
    kind = {"square": SquareWave, "sine": SineWave, "trapezoid": Trapezoid}[waveform]
    extra = (0.2,) if waveform == "trapezoid" else ()
    front, rear = kind(3.0, 2e5, 0.0, *extra), kind(3.0, -1.2e5, 0.3, *extra)
    for t in np.random.default_rng(0).uniform(0.0, 2.0, 200):
        expected = [
            float(w.segment(jnp.asarray(t), jnp.asarray(t + 1e-7)).a0) for w in (front, rear)
        ]
        assert drive.signed(float(t)) == pytest.approx(expected, abs=1e-6 * 2e5)


def test_a_recorded_drive_is_linear_between_its_samples():
    drive = ChamberDrive(
        "recorded", times=np.array([0.0, 1.0]), recorded=np.array([[0, 10], [4, -10.0]])
    )
    assert drive.signed(0.25) == (1.0, 5.0)
    assert drive.layout.split(drive.signed(1.0)) == (4.0, 0.0, 0.0, 10.0)
    with pytest.raises(RigError, match="is not finite"):
        ChamberDrive("recorded", times=np.array([0.0, 1.0]), recorded=np.full((2, 2), np.nan))


@pytest.mark.parametrize("layout", [SLIDER, THREE_PAIRS])
def test_a_waveform_is_uploaded_and_played_by_the_manifold(layout):
    """With six chambers, fewer samples fit into a frame."""
    device = simulated_rig(layout, LineFaults())
    device.tank.lag = 1e-3
    rest = (0.0,) * (len(layout.names) - 2)
    samples = [(1000.0 * i, *rest, 500.0 * i) for i in range(21)]
    with serve_in_thread(device) as served, Manifold(open_port(served.path)) as manifold:
        manifold.configure(PressureLimits.of([250e3], layout))
        with pytest.raises(RigError, match="samples; allowed 2 to 2000"):
            manifold.upload(samples[:1], 0.01)
        manifold.upload(samples, 0.01)
        manifold.arm()
        manifold.play(1)
        highest, end = 0, time.monotonic() + 0.4
        while time.monotonic() < end:
            manifold.heartbeat()
            if manifold.latest is not None:  # on a busy computer, the first status comes late
                highest = max(highest, manifold.latest.channels[0])
            time.sleep(0.02)
        assert highest == pytest.approx(20_000, rel=0.01)
        assert device.core.set_pressures == (20_000, *rest, 10_000)


def test_another_protocol_is_refused():
    device = SimulatedRig(BenchTank(), ManifoldCore(protocol=7, version=(2, 3, 4)))
    with serve_in_thread(device) as served, pytest.raises(RigError, match="2.3.4 uses protocol 7"):
        Manifold(open_port(served.path)).__enter__()


@pytest.mark.parametrize(
    ("robot", "manifold", "message"),
    [
        (
            SLIDER,
            THREE_PAIRS,
            r"chambers: the robot has 4 \(front_left, .*, rear_right\), but the manifold has 6; "
            "give the experiment file of the robot that is connected",
        ),
        (ONE_CHAMBER, SLIDER, r"chambers: the robot has 1 \(fin\), but the manifold has 4; give"),
    ],
)
def test_a_robot_with_another_number_of_chambers_is_refused(robot, manifold, message, tmp_path):
    device = simulated_rig(manifold)
    with serve_in_thread(device) as served:
        rig = rig_on(served.path, robot)
        trial = PlannedTrial("a", ChamberDrive("sine", 2.0, 50e3, layout=robot), 0.3)
        with rig.manifold, pytest.raises(RigError, match=message):
            run_trials([trial], rig, tmp_path, {})
    assert not list((tmp_path / RECORDINGS).iterdir())
    assert device.core.state == ManifoldState.BOOT


def test_a_recording_of_a_manifold_with_another_number_of_chambers_is_refused(tmp_path):
    drive = ChamberDrive("sine", 2.0, 50e3, layout=ONE_CHAMBER)
    run_on_simulated_rig(tmp_path, [PlannedTrial("a", drive, 0.3)], layout=ONE_CHAMBER)
    recording = read_recording(tmp_path / RECORDINGS / "a.h5")
    with pytest.raises(RigError, match=r"the manifold has 1, but the robot has 4 \(front_left, "):
        trial_columns(recording, 0, 0.3, SLIDER, {})


def test_a_limit_above_the_hard_limit_is_refused():
    with serve_in_thread(SimulatedRig(BenchTank())) as served:
        with Manifold(open_port(served.path)) as manifold:
            with pytest.raises(RigError, match="front_left: given 600000 Pa; allowed at most"):
                manifold.configure(PressureLimits.of([600e3], SLIDER))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ([1.0], "limits, front_left: given 1; allowed 1e3 to 2e\\+06 Pa; not kPa or psi"),
        ([2e5, 2e5], "given 2 pressures; allowed one for all chambers, or 4"),
        ([float("nan")] * 4, "given nan"),
    ],
)
def test_impossible_limits_are_refused(given, message):
    with pytest.raises(RigError, match=message):
        PressureLimits.of(given, SLIDER)


def test_the_error_says_whether_a_port_is_missing_busy_or_not_serial(tmp_path):
    with pytest.raises(RigError, match="no such port; available ports: "):
        open_port("/dev/ttyNOTHING")
    plain = tmp_path / "file"
    plain.write_text("")
    with pytest.raises(RigError, match="not a serial port|cannot be opened"):
        open_port(str(plain))
    with serve_in_thread(SimulatedRig(BenchTank())) as served:
        with open_port(served.path):
            with pytest.raises(RigError, match="busy; another program has opened the port"):
                open_port(served.path)


@pytest.mark.skipif(not Path("/dev/tty").exists() or os.name != "posix", reason="POSIX ports only")
def test_the_error_for_a_forbidden_port_names_the_group_to_join(monkeypatch):
    import serial

    def refuse(*arguments, **options):
        raise serial.SerialException(13, "could not open port: Permission denied")

    monkeypatch.setattr(serial, "Serial", refuse)
    with pytest.raises(RigError, match="no permission; .*dialout"):
        open_port("/dev/tty")
