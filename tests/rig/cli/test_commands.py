"""The commands of `slider rig` with a simulated rig: check, run, replay, log, loop."""

import json
import re
import shutil
import time

import numpy as np
import pytest

from calibration.pressure_logs.read import read_log
from rig.cli.shared import declare_swing, install_experiment, layout_in
from rig.cli.simulate import RobotTank
from rig.errors import RigError
from rig.protocol.messages import Arm, FrameDecoder, Reading, SetLimits, SetPressures, encode_frame
from rig.recording.decode import drive_span
from rig.recording.reader import read_recording
from rig.recording.table import AnalogueSensor
from rig.recording.writer import Recorder
from rig.scheduling import real_time_priority
from rig.simulated.manifold import HARD_LIMIT, ManifoldCore
from rig.simulated.rig import SimulatedRig
from rig.simulated.tank import BenchTank
from rig.simulated.terminal import serve_in_thread
from rig.trial.session import changed_settings
from rig.trial.settling import Stillness
from slider_jax.cli.main import main
from slider_jax.errors import InputError
from tests.support.command import served, slider
from tests.support.data import ROOT
from tests.support.rig_experiment import EXPERIMENT


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rig")
    with served("rig", "simulate", cwd=folder) as port:
        yield port, folder


@pytest.fixture(scope="module")
def measured(rig):
    port, folder = rig
    experiment = folder / "given"
    experiment.mkdir()
    (experiment / "experiment.toml").write_text(EXPERIMENT.format(duration=1.0))
    rig_file, out = folder / "simulated_rig.toml", folder / "measured"
    done = slider("rig", "run", experiment / "experiment.toml", "--port", port, "--rig", rig_file,
                  "--out", out)  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done, out


@pytest.mark.parametrize(
    "arguments",
    [
        ("--help",),
        ("rig", "--help"),
        ("rig", "ports"),
        *(
            pytest.param(("rig", x, "--help"), marks=pytest.mark.slow)
            for x in ("check", "run", "log", "replay", "simulate")
        ),
    ],
)
def test_the_rigs_commands_start_without_jax(arguments):
    """Other tests run check, run, log, replay and simulate in full without JAX."""
    done = slider(*arguments)
    assert done.returncode == 0, done.stderr
    assert done.stdout


def test_a_check_prints_the_firmware_and_has_no_findings(rig):
    port, folder = rig
    rig_file = folder / "simulated_rig.toml"
    arguments = ("rig", "check", "--port", port, "--rig", rig_file, "--out", folder / "check.json")
    done = slider(*arguments)
    assert done.returncode == 0, done.stderr
    assert re.search(r"force sensor: (99\d|100\d) records/s, 0 lost", done.stdout)
    assert "firmware 1.1.0, protocol 1" in done.stdout and "no findings" in done.stdout
    found = json.loads((folder / "check.json").read_text())
    assert [x["name"] for x in found["held"]][0] == "front_left"
    assert all(abs(x["reached"] - 50e3) < 1e3 for x in found["held"])
    assert found["force"]["noise"][0] == pytest.approx(3e-3, rel=0.5)
    # The lag of the simulated chambers is 50 ms.
    assert all(0.03 < x["rise"] < 0.09 for x in found["held"])


@pytest.mark.slow
def test_a_check_finds_a_leak(tmp_path):
    leak = "leak_rear_left=3@0"
    with served("rig", "simulate", "--inject", leak, "--noise", "0", cwd=tmp_path) as port:
        done = slider("rig", "check", "--port", port)
    assert done.returncode == 1
    assert "rear_left reached 43.5 kPa instead of 50.0: possibly a leak" in done.stdout
    assert done.stdout.count("a leak") == 1


def test_a_run_writes_an_experiments_folder(measured):
    done, out = measured
    assert "a.csv" in done.stdout and "slider close-loop" in done.stderr
    found = np.genfromtxt(out / "a.csv", delimiter=",", names=True)
    assert found.dtype.names == ("t_s", "p_front_Pa", "p_rear_Pa", "thrust_N", "recoil_N", "tip_m")
    assert len(found) == pytest.approx(500, abs=1) and np.isfinite(found.tolist()).all()
    # The first half stride of 0.1 s fills the empty chamber towards 200 kPa, with a lag of 50 ms.
    peak = 200e3 * (1.0 - np.exp(-2.0))
    assert np.abs(found["p_front_Pa"]).max() == pytest.approx(peak, rel=0.05)
    # In the simulated bench, thrust is proportional to the square of the tip's speed.
    speed = np.gradient(found["tip_m"], found["t_s"])
    assert np.corrcoef(found["thrust_N"], speed**2)[0, 1] > 0.97
    record = json.loads((out / "recordings" / "a.json").read_text())
    # Tests that run at the same time may delay the commands.
    assert [x for x in record["findings"] if "too busy" not in x] == []
    assert record["readings_lost"] == 0 and abs(record["clock_rate"] - 1.0) < 1e-3
    assert record["settings"]["rig"]["force"]["thrust"] == "+Fx" and "h5py" in record["versions"]


def test_the_simulator_reads_the_folder(measured):
    from slider_jax.experiment.load import load, read_measured as columns_of

    experiment = load(measured[1] / "experiment.toml")
    columns = columns_of(experiment, experiment.trials[0])
    assert set(columns) == {"t_s", "p_front_Pa", "p_rear_Pa", "thrust_N", "recoil_N", "tip_m"}


def test_a_replay_reproduces_the_files_of_the_run(measured, tmp_path):
    """The recording contains the box's counts, so a replay needs neither the box nor a rig file."""
    out = tmp_path / "converted"
    done = slider("rig", "replay", measured[1], "--out", out)
    assert done.returncode == 0, done.stderr
    assert sorted(x.name for x in out.iterdir()) == ["a.csv", "a.played.csv", "experiment.toml"]
    for name in ("a.csv", "a.played.csv"):
        assert (out / name).read_bytes() == (measured[1] / name).read_bytes()


def test_a_replay_converts_the_recording_of_a_killed_run(measured, tmp_path):
    """The first command gives the beginning of the drive."""
    folder, out = tmp_path / "folder", tmp_path / "converted"
    shutil.copytree(measured[1], folder)
    recordings = folder / "recordings"
    (recordings / "a.h5").rename(recordings / "a.unfinished-1.h5")
    (recordings / "a.json").unlink()
    (recordings / "b.h5").write_bytes(b"torn")
    done = slider("rig", "replay", folder, "--out", out)
    assert done.returncode == 1, done.stderr
    assert "unfinished: only 1.00 s of the drive were recorded" in done.stdout
    assert "b.h5: not converted: recording" in done.stderr and "is incomplete" in done.stderr
    before, after = (
        np.genfromtxt(path, delimiter=",", names=True)
        for path in (measured[1] / "a.csv", out / "a.unfinished-1.csv")
    )
    assert len(after) == pytest.approx(len(before), abs=2)
    assert after["t_s"][0] == pytest.approx(before["t_s"][0], abs=2.5e-3)
    assert (out / "a.unfinished-1.played.csv").exists()
    (recordings / "a.unfinished-1.h5").unlink()
    done = slider("rig", "replay", folder, "--out", tmp_path / "nothing")
    assert done.returncode == 2 and "no recording could be read" in done.stderr
    assert not (tmp_path / "nothing").exists()


def test_a_recording_without_a_drive_is_refused(tmp_path):
    path = tmp_path / "a.h5"
    with Recorder(path, ("manifold", "commands")) as recorder:
        recorder.sink("commands")(1, encode_frame(SetPressures(1, (0, 0, 0, 0))))
    with pytest.raises(RigError, match="the run ended before the drive began"):
        drive_span(read_recording(path))


SENSORS = "[sensors]  # of the lab\npressure_noise = 10.0\n"


@pytest.mark.parametrize(
    ("sensors", "after"),
    [
        ("", "0.0004"),
        (SENSORS, "0.0004"),
        (SENSORS + "start_swing = 0.0\n", "0.0004"),
        (SENSORS + "start_swing = 3e-4\n", "3e-4"),
    ],
)
def test_the_tips_swing_is_declared_and_the_folder_can_be_used_again(sensors, after, tmp_path):
    given, path = tmp_path / "given.toml", tmp_path / "out" / "experiment.toml"
    given.write_text(EXPERIMENT.format(duration=1.0).replace("[[trials]]", f"{sensors}[[trials]]"))
    path.parent.mkdir()
    install_experiment(given, path.parent)
    record = {"at_rest_deviation": {"tip_m": 5e-4}, "at_rest_noise": {"tip_m": 3e-4}}
    declare_swing(path, [record])
    assert re.findall(r"start_swing = (\S+)", path.read_text()) == [after]
    assert "noise = 10.0" in path.read_text() or not sensors
    added = path.read_text() + '\n[[trials]]\nfile = "b.csv"\nfrequency = 1.0\namplitude = 1e4\n'
    path.write_text(added + "duration = 1.0\n")
    install_experiment(given, path.parent)
    assert path.read_text() == added + "duration = 1.0\n"
    given.write_text(given.read_text().replace("C_d = 2.0", "C_d = 2.1"))
    (path.parent / "b.csv").touch()
    with pytest.raises(InputError, match=r"contains b\.csv, not in .*given\.toml"):
        install_experiment(given, path.parent)
    (path.parent / "b.csv").unlink()
    install_experiment(given, path.parent)
    assert path.read_text() == given.read_text()


def test_a_replay_uses_other_axes_of_a_rig_file(measured, tmp_path):
    rig_file = tmp_path / "rig.toml"
    rig_file.write_text(
        '[force]\nhost = "none"\nthrust = "-Fx"\n'
    )  # the counts are in the recording
    out = tmp_path / "converted"
    done = slider("rig", "replay", measured[1], "--out", out, "--rig", rig_file)
    assert done.returncode == 0, done.stderr
    before, after = (
        np.genfromtxt(folder / "a.csv", delimiter=",", names=True) for folder in (measured[1], out)
    )
    assert np.allclose(after["thrust_N"], -before["thrust_N"], atol=1e-12)
    assert np.array_equal(after["t_s"], before["t_s"]) and "tip_m" not in after.dtype.names
    assert "no tip_m: the rig file has no such sensor" in done.stdout


def test_a_replay_sends_the_recorded_bytes_on_a_port(measured, tmp_path):
    from rig.manifold.serial_port import open_port

    recording = measured[1] / "recordings" / "a.h5"
    with served("rig", "replay", recording, "--speed", "0.5", cwd=tmp_path) as port:
        time.sleep(0.5)
        line, decoder, found = open_port(port), FrameDecoder(), []
        end = time.monotonic() + 3.0
        while time.monotonic() < end:
            found += [m for m in decoder.feed(line.read(4096)) if isinstance(m, Reading)]
        line.close()
    # The replay begins when the program opens the port.
    first = read_recording(recording).streams["manifold"].pieces()
    begun = next(m for m in FrameDecoder().feed(b"".join(first)) if isinstance(m, Reading))
    assert found[0].seq - begun.seq <= 5
    assert len(found) > 200 and np.all(np.diff([m.seq for m in found]) == 1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("run", "{exp}", "--port", "/dev/ttyNONE", "--out", "{out}"), "no such port"),
        (("run", "none.toml", "--port", "x", "--out", "{out}"), "none.toml: no such file"),
        (("run", "{exp}", "--port", "x", "--out", "{here}"), "is the experiment's own folder"),
        (
            ("run", "{exp}", "--port", "x", "--out", "{out}", "--limit", "250"),
            "--limit, front_left: given 250; allowed 1e3 to 2e+06 Pa; not kPa or psi",
        ),
        (("check", "--port", "x", "--pressure", "9e5"), "front_left: given 900000 Pa; allowed 0"),
        (("simulate", "--inject", "leak"), "--inject: given 'leak'; allowed FAULT=VALUE@SECONDS"),
        (("simulate", "--flipped", "2"), "--flipped: given 2; allowed 0 to 0.5, a fraction"),
        (("simulate", "--noise", "-1"), "--noise: given -1; allowed 0 or more"),
        (("simulate", "--rig-file", "{exp}"), "exists, and was not written by `slider rig"),
        (
            ("simulate", "{exp}", "--published"),
            "--published: given with an experiment; allowed --noise",
        ),
        (("run", "{exp}", "--port", "x", "--out", "{out}", "--rig", "{exp}"), "is an experiment"),
        (("check", "--port", "{exp}"), "experiment.toml: not a serial port"),
        (("simulate", "--inject", "leak_front_left=nan@1"), "with numbers from 0"),
        (("replay", "{here}"), "--out: missing"),
        (("replay", "{here}", "--out", "{out}"), "has no recordings/*.h5"),
        (("replay", "{exp}"), "is incomplete or not a recording"),
        (("log", "9", "--port", "x", "--out", "{out}"), "frequencies: given 9; allowed 0.1 to 5"),
    ],
)
def test_invalid_input_is_reported_in_one_message(arguments, message, tmp_path, capsys):
    path = tmp_path / "experiment.toml"
    path.write_text(EXPERIMENT.format(duration=1.0))
    names = {"exp": path, "out": tmp_path / "out", "here": tmp_path}
    assert main(["rig", *(x.format(**names) for x in arguments)]) == 2
    error = capsys.readouterr().err
    assert message in error and error.startswith("slider: error: ")
    assert not (tmp_path / "out").exists()


def test_a_limit_is_checked_before_anything_moves(rig, tmp_path):
    path = tmp_path / "experiment.toml"
    path.write_text(EXPERIMENT.format(duration=1.0).replace("200e3", "260e3"))
    out = tmp_path / "out"
    done = slider("rig", "run", path, "--port", rig[0], "--out", out)
    assert done.returncode == 2 and not out.exists()
    assert "trial a: set pressure of front_left: given 260000 Pa; allowed 0 to" in done.stderr


EEL = ROOT / "examples" / "eel" / "experiment.toml"


@pytest.mark.parametrize(
    "words", [("check", EEL), ("run", EEL, "--out", "{out}")], ids=["check", "run"]
)
def test_a_robot_with_another_number_of_chambers_is_refused(words, rig, tmp_path):
    out = tmp_path / "out"
    done = slider("rig", *(str(x).format(out=out) for x in words), "--port", rig[0],
                  *(("--limit", "400e3") if words[0] == "run" else ()))  # fmt: skip
    assert done.returncode == 2 and not out.exists()
    assert "chambers: the robot has 6 (head_left, head_right, " in done.stderr
    assert "but the manifold has 4; give the experiment file" in done.stderr


def test_the_eel_is_checked_measured_and_read_again(tmp_path):
    """A bench with three pairs of chambers. The last chamber leaks."""
    path, out = tmp_path / "eel.toml", tmp_path / "out"
    text = EEL.read_text().replace("duration = 3.75 ", "duration = 1.0 ")
    text = text[: text.index('[[trials]]\nfile = "towed.csv"')].replace("250.0 ", "500.0 ")
    path.write_text(text)
    layout, rig_file = layout_in(path), tmp_path / "rig.toml"
    bench = BenchTank(layout)
    bench.leak[-1] = 2.0
    device = SimulatedRig(bench, ManifoldCore((HARD_LIMIT,) * len(layout.names)))
    rig_file.write_text('[[analogue]]\ncolumn = "tip_m"\ninput = 1\nscale = 0.1\n')
    with real_time_priority(), serve_in_thread(device) as simulated:
        arguments = ("--port", simulated.path, "--rig", rig_file)
        check = slider("rig", "check", path, *arguments, "--out", tmp_path / "check.json")
        done = slider("rig", "run", path, *arguments, "--out", out)
    assert check.returncode == 1, check.stderr
    assert "rear_right reached 45.5 kPa instead of 50.0: possibly a leak" in check.stdout
    held = json.loads((tmp_path / "check.json").read_text())["held"]
    assert tuple(x["name"] for x in held) == layout.names
    assert [x["reached"] for x in held[:-1]] == pytest.approx([50e3] * 5, rel=1e-3)
    assert done.returncode == 0, done.stderr
    assert re.search(r"head +-?\d+\.\d middle +-?\d+\.\d rear +-?\d+\.\d kPa", done.stderr)
    found = np.genfromtxt(out / "slow.csv", delimiter=",", names=True)
    assert found.dtype.names == ("t_s", *layout.columns, "tip_m")
    # Until its delay, a chamber follows -200 kPa, and then 200 kPa, with the lag of 50 ms.
    at = np.argmin(np.abs(found["t_s"] - 0.45))
    for column, late in zip(layout.columns, (0.0, 0.1875, 0.375), strict=True):
        before = 1.0 - np.exp(-late / 0.05)
        expected = 200e3 * (1.0 - (1.0 + before) * np.exp(-(found["t_s"][at] - late) / 0.05))
        assert found[column][at] == pytest.approx(expected, abs=15e3)  # the commands may be late
    again = tmp_path / "again"
    done = slider("rig", "replay", out, "--out", again)
    assert done.returncode == 0, done.stderr
    for name in ("slow.csv", "slow.played.csv"):
        assert (again / name).read_bytes() == (out / name).read_bytes()
    (out / "experiment.toml").unlink()
    done = slider("rig", "replay", out, "--out", tmp_path / "nothing")
    assert done.returncode == 2
    assert "the manifold has 6, but the robot has 4 (front_left, " in done.stderr


@pytest.mark.slow
def test_the_simulated_robot_has_the_chambers_of_the_experiment(tmp_path):
    """In virtual time: the readings have the lag's exact pressures in all six chambers."""
    from slider_jax.experiment.load import load
    from slider_jax.realtime.plant import Plant

    path, asked = tmp_path / "eel.toml", (200_000, 0, 0, 150_000, 100_000, 0)
    path.write_text(EEL.read_text().replace("nodes = 53", "nodes = 15"))
    tank = RobotTank(Plant(load(path), step=1e-3))
    device = SimulatedRig(tank, ManifoldCore((HARD_LIMIT,) * len(asked)))
    decoder, found = FrameDecoder(), []
    device.tick(0)
    for message in (SetLimits(1, (250_000,) * 6), Arm(2), SetPressures(3, asked)):
        device.feed(encode_frame(message), 0)
    for now in range(1000, 91_000, 1000):
        found += decoder.feed(device.tick(now))
    expected = np.array(asked) * (1.0 - np.exp(-0.09 / 0.087))
    assert found[-1].device_us == 90_000
    assert found[-1].pressures == pytest.approx(expected, abs=1.0)
    assert found[-1].channels[7] != 0  # the tip moves


def test_a_check_of_a_bad_line_reports_damaged_frames(tmp_path):
    """Also if so few commands arrive that the manifold vents during the check."""
    with served("rig", "simulate", "--flipped", "0.04", cwd=tmp_path) as port:
        done = slider("rig", "check", "--port", port)
    assert done.returncode in (1, 2)
    assert re.search(r"[1-9]\d* frames (arrived )?damaged", done.stdout + done.stderr), done.stderr


@pytest.mark.slow
def test_a_check_and_a_run_on_a_poor_line_end_and_report_losses(tmp_path):
    path = tmp_path / "given.toml"
    path.write_text(EXPERIMENT.format(duration=1.0))
    with served("rig", "simulate", "--flipped", "0.001", cwd=tmp_path) as port:
        done = slider("rig", "check", "--port", port)
        assert done.returncode == 1, done.stderr
        assert re.search(r"[1-9]\d* of 50 commands were not answered|frames damaged", done.stdout)
        assert "front_left " in done.stdout
        done = slider("rig", "run", path, "--port", port, "--out", tmp_path / "out")
    assert done.returncode == 1
    assert "1 of 1 trials lost more than 1 % of their readings" in done.stderr


def test_a_run_is_resumed_with_a_rig_at_another_address():
    before = {"rig": {"force": {"host": "a", "port": 1, "thrust": "+Fx"}}}
    moved = {"rig": {"force": {"host": "b", "port": 2, "thrust": "+Fx"}}}
    turned = {"rig": {"force": {"host": "a", "port": 1, "thrust": "-Fx"}}}
    assert changed_settings(before, moved) == [] and changed_settings(before, turned) == [
        "rig.force.thrust"
    ]


def test_a_log_of_the_simulated_published_firmware_is_recorded(tmp_path):
    with served("rig", "simulate", "--published", cwd=tmp_path) as port:
        done = slider("rig", "log", "5", "--port", port, "--out", tmp_path / "logs")
    assert done.returncode == 0, done.stderr
    assert "5.txt  1000 rows: no findings" in done.stdout
    assert not (tmp_path / "simulated_rig.toml").exists()
    log = read_log(tmp_path / "logs" / "5.txt")
    assert np.ptp(log.pressure) > 200


def test_a_pause_names_the_sensor_that_still_moves():
    sensor = AnalogueSensor("tip_m", 1, 0.1)
    still = Stillness((sensor,), {"tip_m": 0.08}, {"tip_m": 0.0})
    for i in range(200):
        volts = 1e6 * (0.02 * np.sin(i))
        still.add(0.02 * i, Reading(i, 0, 2, 0, (0, 0, 0, 0, 0, volts, 0, 0)))
    assert not still.reached
    assert still.waits_for == ", until the range of tip_m is below 0.4 mm (now 4 mm),"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "trials: given 1; allowed 3 or more"),
        (("--amplitude", "2e5", "1e5"), "--amplitude: given 200000 100000; allowed LOW HIGH"),
        (("--amplitude", "100", "200"), "--amplitude: given 100; allowed 0, or 1000 to 2e+06 Pa"),
        (("--phase", "0.1"), "--phase"),
    ],
)
def test_a_loop_with_invalid_arguments_is_refused(arguments, message, tmp_path, capsys):
    path, out = tmp_path / "experiment.toml", tmp_path / "out"
    text = EXPERIMENT.format(duration=1.0)
    trial = text[text.index("[[trials]]") :]
    for name in "bc" if arguments else "":
        text += "\n" + trial.replace("a.csv", f"{name}.csv")
    path.write_text(text)
    assert main(["rig", "loop", str(path), "--port", "x", "--out", str(out), *arguments]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line and not out.exists()
