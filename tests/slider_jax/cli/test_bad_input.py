"""Tests of invalid input of `slider simulate`: exit code 2, a message of one line, no results."""

import numpy as np
import pytest

from slider_jax.cli.main import main
from tests.support.experiments import write_small_experiment

FIRST = '[[trials]]\nfile = "trial_00.csv"\nfrequency = 4.0\namplitude = 150000.0'
RECORDED = '[[trials]]\nfile = "trial_00.csv"\nwaveform = "recorded"\ndrive_file = "drive.csv"'

TOML_CASES = {
    "not TOML": (("C_d = 3.0", "C_d = = 3.0"), ("not valid TOML", "line 16, column 7")),
    "number with a unit": (
        ("amplitude = 150000.0", "amplitude = 150 kPa"),
        ("not valid TOML", "numbers in SI units, without the unit: convert 150, remove kPa"),
    ),
    "key given twice": (("m_a = 1.0", "C_d = 1.0"), ("not valid TOML", "line 17")),
    "unknown table": (("[sensors]", "[sensor]"), ("sensor: unknown key", "did you mean sensors?")),
    "unknown key": (("height =", "heigth ="), ("robot.heigth: unknown key", "mean height?")),
    "missing key": (("height = 0.03\n", ""), ("robot.height: missing", "in m")),
    "missing table": (
        ("[parameters]\nC_d = 3.0\nm_a = 1.0\nk = 0.087\nK_Q = 4.79e-07\n", ""),
        ("parameters: missing; add a table [parameters] with k, K_Q",),
    ),
    "no coefficient": (
        ("m_a = 1.0\n", ""),
        ('parameters.m_a: given nothing; allowed a number, unless force_coefficients is "ramp"',),
    ),
    "coefficient beside the ramp": (
        ("m_a = 1.0", 'force_coefficients = "ramp"'),
        ('parameters.C_d: given 3.0; allowed only with force_coefficients = "fixed"', "omit this"),
    ),
    "unknown coefficients": (
        ("m_a = 1.0", 'm_a = 1.0\nforce_coefficients = "paper"'),
        ("parameters.force_coefficients: given 'paper'; allowed 'fixed', 'ramp' or 'table'",),
    ),
    "text for a number": (("C_d = 3.0", 'C_d = "3"'), ("parameters.C_d", "allowed a number")),
    "boolean for a number": (("C_d = 3.0", "C_d = true"), ("parameters.C_d", "allowed a number")),
    "NaN": (("C_d = 3.0", "C_d = nan"), ("parameters.C_d: given nan; allowed 0 to 20",)),
    "infinity": (("k = 0.087", "k = inf"), ("parameters.k: given inf", "0.001 to 2 s")),
    "millimetres": (
        ("body_length = 0.3", "body_length = 300.0"),
        ("robot.body_length: given 300.0; allowed 0.05 to 3 m; lengths are in metres",),
    ),
    "grams per metre": (("density = 0.7", "density = 700.0"), ("robot.linear_density", "kg/m")),
    "kilopascal": (("150000.0", "150.0"), ("trials.0.amplitude", "1000 to 2e+06 Pa", "kPa")),
    "milliseconds": (("k = 0.087", "k = 87.0"), ("parameters.k", "times are in seconds")),
    "phase in degrees": (("phase = 0.1", "phase = 36.0"), ("trials.0.phase", "not in degrees")),
    "speed in cm/s": (("tow_speed = 0.2\n", "tow_speed = 20.0\n"), ("trials.1.tow_speed", "m/s")),
    "negative stiffness": (("EI_tail = 0.0058", "EI_tail = -0.0058"), ("robot.EI_tail",)),
    "negative frequency": (("frequency = 4.0", "frequency = -4.0"), ("trials.0.frequency", "Hz")),
    "no frequency": (("frequency = 4.0\n", ""), ("trials.0.frequency", "square")),
    "chambers overlap": (("[0.155, 0.28]", "[0.1, 0.28]"), ("robot.rear_chamber", "0.145] m")),
    "chamber beyond the body": (("0.28]", "0.31]"), ("robot.rear_chamber", "0 to 0.3 m")),
    "chamber reversed": (("[0.02, 0.145]", "[0.145, 0.02]"), ("robot.front_chamber", "near < far")),
    "chamber with one end": (("[0.02, 0.145]", "[0.02]"), ("robot.front_chamber.1: missing",)),
    "duplicate trial files": (
        ('"trial_01.csv"', '"trial_00.csv"'),
        ("trials.1.file", "trials.0 has this name"),
    ),
    "trial file outside the folder": (
        ('"trial_01.csv"', '"../trial_01.csv"'),
        ("trials.1.file", "plain file name"),
    ),
    "trial file hides the summary": (
        ('"trial_01.csv"', '"summary.json"'),
        ("trials.1.file", "ending in .csv"),
    ),
    "step beyond the half period": (
        ("step = 0.005", "step = 0.02"),
        ("numerics.step: given 0.02; allowed at most 0.0125 s", "trials.0"),
    ),
    "too few nodes": (("nodes = 11", "nodes = 4"), ("numerics.nodes: given 4", "11")),
    "nodes not whole": (("nodes = 11", "nodes = 16.5"), ("numerics.nodes: given 16.5", "integer")),
    "unknown scheme": (
        ("nodes = 11", 'scheme = "rk4"'),
        ("numerics.scheme: given 'rk4'; allowed 'sdirk2' or 'backward_euler'",),
    ),
    "unknown waveform": (
        ("phase = 0.1", 'waveform = "saw"'),
        ("trials.0.waveform: given 'saw'", "'trapezoid'"),
    ),
    "unknown effect": (("[robot]", '[[effects]]\nname = "Magic"\n[robot]'), ("effects.0.name",)),
    "recorded without a file": (
        (FIRST, '[[trials]]\nfile = "trial_00.csv"\nwaveform = "recorded"'),
        ("trials.0.drive_file: given nothing",),
    ),
    "drive file without recorded": (
        ("phase = 0.1", 'drive_file = "drive.csv"'),
        ("trials.0.drive_file", "only with waveform"),
    ),
    "drive file missing": ((FIRST, RECORDED), ("drive.csv: no such file",)),
}


def _refused(arguments, capsys, out, *fragments) -> None:
    """Checks that the command exits with 2, prints one line with `fragments` and writes nothing."""
    assert main([str(argument) for argument in arguments]) == 2
    message = capsys.readouterr().err.strip()
    assert message.startswith("slider: error: ")
    assert len(message.splitlines()) == 1
    for fragment in fragments:
        assert fragment in message
    assert "Traceback" not in message
    if out.is_dir():
        assert list(out.iterdir()) == []


@pytest.mark.parametrize("case", TOML_CASES)
def test_invalid_toml_is_rejected_with_its_key(case, tmp_path, capsys):
    change, fragments = TOML_CASES[case]
    path, out = write_small_experiment(tmp_path, change), tmp_path / "out"
    _refused(["simulate", path, "--out", out], capsys, out, *fragments)


def test_an_experiment_without_trials_is_rejected(tmp_path, capsys):
    path, out = write_small_experiment(tmp_path), tmp_path / "out"
    path.write_text(path.read_text().split("[[trials]]")[0])
    _refused(
        ["simulate", path, "--out", out], capsys, out, "trials: missing; add a table [[trials]]"
    )
    path.write_text("trials = []\n" + path.read_text())
    _refused(["simulate", path, "--out", out], capsys, out, "trials: ", "at least 1 item")


HEADER = "t_s,p_front_Pa,p_rear_Pa,thrust_N,recoil_N,tip_m\n"
CSV_CASES = {
    "empty": ("", ("empty",)),
    "header alone": (HEADER, ("0 rows", "at least 2")),
    "column missing": ("time,thrust_N\n0,1\n0.002,1\n", ("line 1: column t_s is missing",)),
    "text": ("t_s,thrust_N\n0.000,1\n0.002,one\n", ("line 3, column thrust_N: given 'one'",)),
    "NaN": ("t_s,thrust_N\n0.000,1\n0.002,nan\n", ("line 3, column thrust_N", "finite")),
    "blank time": ("t_s,thrust_N\n0.000,1\n,2\n", ("line 3, column t_s: given ''",)),
    "torn line": ("t_s,thrust_N\n0.000,1\n0.002\n", ("line 3: 1 cells; the header has 2",)),
    "time stands still": ("t_s\n0.000\n0.002\n0.002\n0.004\n", ("line 4", "must increase")),
    "time runs back": ("t_s\n0.000\n0.002\n0.001\n0.004\n", ("line 4", "must increase")),
    "past the duration": ("t_s\n0.7\n0.750\n0.760\n", ("duration of 0.75 s",)),
    "before the start": ("t_s\n-0.002\n0.000\n0.002\n", ("samples from -0.002",)),
    "another rate than the sensors'": ("t_s\n0.0\n0.001\n0.002\n", ("1000 Hz", "500 Hz")),
}


@pytest.mark.parametrize("case", CSV_CASES)
def test_invalid_samples_are_rejected_with_their_line(case, tmp_path, capsys):
    content, fragments = CSV_CASES[case]
    path, out = write_small_experiment(tmp_path), tmp_path / "out"
    (tmp_path / "trial_00.csv").write_text(content)
    _refused(["simulate", path, "--out", out], capsys, out, "trial_00.csv", *fragments)


def _drive_with(times, pressure) -> str:
    rows = [f"{t:.6f},{p},{p}" for t, p in zip(times, pressure, strict=True)]
    return "\n".join(["t_s,p_front_Pa,p_rear_Pa", *rows]) + "\n"


_T = np.arange(0.0, 0.76, 0.01)
DRIVE_CASES = {
    "short": (_drive_with(_T[:20], 1e5 + 0 * _T[:20]), ("covers 0 to 0.19 s", "0.75 s")),
    "milliseconds": (
        _drive_with(1e3 * _T, 1e5 + 0 * _T),
        ("t_s covers 0 to 750", "0.75 s", "t_s must be in seconds: divide milliseconds by 1000"),
    ),
    "late": (_drive_with(_T + 0.02, 1e5 + 0 * _T), ("covers 0.02 to 0.77 s", "lasts from 0 to")),
    "NaN": (_drive_with(_T, ["1e5"] * 5 + ["nan"] * 71), ("line 7, column p_front_Pa", "finite")),
    "mixed rates": (
        _drive_with(np.concatenate([_T[:40], 0.4 + 0.005 * np.arange(80)]), [1e5] * 120),
        ("mixed sample rates", "resample"),
    ),
    "kilopascal": (_drive_with(_T, 150.0 + 0 * _T), ("column p_front_Pa", "not kPa")),
    "column missing": ("t_s,p_front_Pa\n0,1\n1,1\n", ("column p_rear_Pa is missing",)),
}


@pytest.mark.parametrize("case", DRIVE_CASES)
def test_an_invalid_recorded_drive_is_rejected(case, tmp_path, capsys):
    content, fragments = DRIVE_CASES[case]
    path, out = write_small_experiment(tmp_path, (FIRST, RECORDED)), tmp_path / "out"
    (tmp_path / "drive.csv").write_text(content)
    _refused(["simulate", path, "--out", out], capsys, out, "drive.csv", *fragments)


MODEL_CASES = {
    "unknown table": ("[robt]\nEI_body = 0.04\n", ("robt: unknown key; allowed name, robot",)),
    "ramp and a coefficient": (
        '[parameters]\nforce_coefficients = "ramp"\nC_d = 3.0\n',
        ("parameters.C_d: given 3.0", "omit this key"),
    ),
    "unknown key": ("[parameters]\nCd = 3.0\n", ("parameters.Cd: unknown key", "mean C_d?")),
    "out of range": ("[parameters]\nk = 87.0\n", ("parameters.k: given 87.0", "in seconds")),
    "not a table": ("robot = 3\n", ("robot: given 3",)),
    "unknown effect": ('[[effects]]\nname = "Magic"\n', ("effects.0.name: given 'Magic'",)),
    "unknown effect's key": ('[[effects]]\nname = "gravity"\nG = 1.0\n', ("effects.0.G", "g")),
    "effect's value is text": ('[[effects]]\nname = "gravity"\ng = "1"\n', ("effects.0.g",)),
    "effect without a name": ("[[effects]]\ng = 1.0\n", ("effects.0.name: missing",)),
    "not TOML": ("k: 0.087\n", ("not valid TOML", "line 1")),
}


@pytest.mark.parametrize("case", MODEL_CASES)
def test_an_invalid_model_file_is_rejected(case, tmp_path, capsys):
    content, fragments = MODEL_CASES[case]
    path, model, out = write_small_experiment(tmp_path), tmp_path / "model.toml", tmp_path / "out"
    model.write_text(content)
    arguments = ["simulate", path, "--model", model, "--out", out]
    _refused(arguments, capsys, out, "model.toml", *fragments)


def test_missing_files_and_folders_are_rejected(tmp_path, capsys):
    path, out = write_small_experiment(tmp_path), tmp_path / "out"
    none = tmp_path / "none.toml"
    _refused(["simulate", none, "--out", out], capsys, out, "none.toml: no such file")
    _refused(["simulate", path, "--model", none, "--out", out], capsys, out, "none.toml: no such")
    folder = tmp_path / "folder.toml"
    folder.mkdir()
    _refused(["simulate", folder, "--out", out], capsys, out, "is a folder")
    _refused(
        ["simulate", tmp_path, "--out", out], capsys, out, "is a folder; give a file in this folder"
    )
    _refused(["calibrate", "manifold", tmp_path, "--out", out], capsys, out, "is a folder")


def test_a_binary_experiment_file_is_rejected(tmp_path, capsys):
    path, out = tmp_path / "experiment.toml", tmp_path / "out"
    path.write_bytes(b"name = \xff\xfe")
    _refused(["simulate", path, "--out", out], capsys, out, "not UTF-8 text (byte 7)")


def test_an_output_folder_that_is_a_file_is_rejected(tmp_path, capsys):
    path, out = write_small_experiment(tmp_path), tmp_path / "out"
    out.write_text("kept")
    _refused(["simulate", path, "--out", out], capsys, out, "--out", "is a file")
    _refused(["simulate", path, "--out", out / "in"], capsys, out, "--out", "is under a file")
    assert out.read_text() == "kept"


def test_an_output_folder_with_measured_files_is_rejected(tmp_path, capsys):
    path, none = write_small_experiment(tmp_path), tmp_path / "none"
    _refused(["simulate", path, "--out", tmp_path], capsys, none, "the experiment's own folder")
    assert [p.name for p in tmp_path.iterdir()] == ["experiment.toml"]


@pytest.mark.parametrize("flag, value", [("step", "5"), ("nodes", "3"), ("scheme", "rk4")])
def test_invalid_numerics_on_the_command_line_are_rejected(flag, value, tmp_path, capsys):
    path, out = write_small_experiment(tmp_path), tmp_path / "out"
    fragments = ("command line", f"numerics.{flag}")
    _refused(["simulate", path, "--out", out, f"--{flag}", value], capsys, out, *fragments)


def test_an_unknown_command_is_rejected(tmp_path, capsys):
    out = tmp_path / "out"
    _refused(
        ["simulat"],
        capsys,
        out,
        "given 'simulat'; allowed simulate, export, demo",
        "mean simulate?",
    )
    _refused(
        ["calibrate", "manifld"], capsys, out, "'calibrate manifld'", "mean calibrate manifold?"
    )
    _refused(["noise"], capsys, out, "given 'noise'; allowed")


@pytest.mark.parametrize("words", [["calibrate"], ["calibrate", "--help"]])
def test_a_group_lists_its_commands(words, capsys):
    try:
        assert main(words) == 0
    except SystemExit as left:  # the help of the group's own command follows
        assert left.code == 0 and words[-1] == "--help"
    fragments = capsys.readouterr().out
    assert "calibrate manifold  fits the pressure lag" in fragments and "sweep" not in fragments


def test_an_unknown_option_is_rejected(tmp_path, capsys):
    path, out = write_small_experiment(tmp_path), tmp_path / "out"
    fragments = "--otu: unknown option; allowed --help, --out, --model", "did you mean --out?"
    _refused(["simulate", "--otu", out, path], capsys, out, *fragments)
    _refused(["simulate", path, f"--otu={out}"], capsys, out, *fragments)
    swept = "--frm: unknown option", "--from2", "did you mean --from?"
    _refused(["sweep", path, "--frm", "1", "--out", out], capsys, out, *swept)


def test_an_interrupted_command_writes_nothing(tmp_path, capsys, monkeypatch):
    import slider_jax.simulation.summary

    def interrupt(*args):
        raise KeyboardInterrupt

    monkeypatch.setattr(slider_jax.simulation.summary, "trial_summary", interrupt)
    path, out = write_small_experiment(tmp_path), tmp_path / "out"
    assert main(["simulate", str(path), "--out", str(out), "--plot"]) == 130
    assert capsys.readouterr().err.strip().endswith("slider: interrupted")
    assert not out.exists()


def test_a_step_that_does_not_converge_is_reported(tmp_path, capsys):
    """With 100 times the moment and 1/100 of the stiffness there is no equilibrium shape."""
    path, out = write_small_experiment(
        tmp_path, ("4.79e-07", "4.79e-05"), ("EI_body = 0.038", "EI_body = 0.0004")
    ), tmp_path / "out"  # fmt: skip
    fragments = ("trial_00.csv", "the step to t = ", "did not converge", "--step")
    assert main(["simulate", str(path), "--out", str(out), "--plot"]) == 2
    message = capsys.readouterr().err.strip().splitlines()[-1]
    assert all(fragment in message for fragment in ("slider: error: ", *fragments))
    assert not out.exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--only", "valve_dely"], "--only: given 'valve_dely'; allowed "),
        (["--without", "no_such"], "--without: given 'no_such'; allowed "),
        (["--only", "leakage", "--without", "leakage"], "no candidate effect remains"),
    ],
)
def test_an_invalid_choice_of_candidates_is_refused(words, said, tmp_path, capsys):
    out, experiment = tmp_path / "out", write_small_experiment(tmp_path)
    assert main(["close-loop", str(experiment), "--out", str(out), *words]) == 2
    assert said in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize("command", ["calibrate", "close-loop"])
def test_missing_input_is_rejected_before_anything_is_written(command, tmp_path, capsys):
    out, experiment = tmp_path / "out", write_small_experiment(tmp_path)
    for words in (
        [tmp_path / "none.toml"],
        [tmp_path],
        [experiment, "--model", tmp_path / "none.toml"],
    ):
        assert main([command, *map(str, words), "--out", str(out)]) == 2
        message = capsys.readouterr().err
        assert str(words[-1]) in message and "Traceback" not in message
        assert not out.exists()


def test_planar_commands_refuse_a_robot_in_three_dimensions_in_one_line(tmp_path, capsys):
    file = write_small_experiment(
        tmp_path,
        ('name = "small"', 'name = "small"\ndimension = 3'),
        ("height = 0.03", "height = 0.03\nGJ_body = 0.03\nGJ_tail = 0.003\npolar_inertia = 6e-5"),
    )
    assert main(["calibrate", str(file), "--out", str(tmp_path / "out")]) == 2
    (line,) = (x for x in capsys.readouterr().err.splitlines() if "finding" not in x)
    assert line.startswith(f"slider: error: {file}: dimension: given 3; allowed 2, because")
