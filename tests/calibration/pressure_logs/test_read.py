"""The reader of the rig's logs lists the faults that it repairs and refuses the others."""

import numpy as np
import pytest

from calibration.pressure_logs.read import PA_PER_PSI, psi, read_log
from calibration.pressure_logs.rows import COLUMNS
from slider_jax.cli.main import main
from slider_jax.errors import InputError
from tests.support.synthetic_log import lag_series, log_lines, write_log

HEAD = 7


@pytest.mark.parametrize("end", ["\r", "\n", "\r\n"])
def test_every_line_ending_gives_the_same_log(tmp_path, end):
    log = read_log(write_log(tmp_path / "log.txt", log_lines(), end))
    command, pressure = lag_series()
    np.testing.assert_allclose(log.command, command)
    np.testing.assert_allclose(log.pressure, pressure)
    np.testing.assert_allclose(log.t, 0.002 * np.arange(1500), atol=1e-12)
    assert (log.frequency, log.period, log.findings) == (1.0, 0.002, ())


def test_counts_become_gauge_pressure(tmp_path):
    log = read_log(write_log(tmp_path / "log.txt", log_lines()))
    assert psi(91.863) == pytest.approx(0.0, abs=1e-3)
    np.testing.assert_allclose(log.pressure_Pa, 6894.757 * (0.13529 * log.pressure - 12.4282))
    assert PA_PER_PSI == 6894.757


def _stale_before_header(lines):
    return ["1,0,250,406.25,-27.75,434", *lines]


def _stale_after_columns(lines):
    return [*lines[:HEAD], "4286,0,250,406.25,-27.75,434", *lines[HEAD:-1], "done1508"]


def _stale_in_place_of_the_first(lines):
    return [*lines[:HEAD], "1,0,250,406.25,-27.75,434", *lines[HEAD + 1 :]]


def _torn(lines):
    return [*lines[:-2], lines[-2][:-9]]


def _no_done(lines):
    return lines[:-1]


def _lost_lines(lines):
    return [*lines[:-1], "done1600"]


def _cell(text):
    def change(lines):
        cells = lines[100].split(",")
        cells[3] = text
        return [*lines[:100], ",".join(cells), *lines[101:]]

    return change


def _duplicate(lines):
    return [*lines[:101], lines[100], *lines[101:-1], "done1508"]


def _gap(lines):
    return [*lines[:100], *lines[110:-1], "done1497"]


def _wrong_stop(lines):
    return [line.replace("4000 ms", "4100 ms") for line in lines]


def _wrong_frequency(lines):
    return [line.replace("1.000000 Hz", "1.100000 Hz") for line in lines]


def _unknown_header_line(lines):
    return [lines[0], "firmware 7", *lines[1:-1], "done1508"]


def _stuck(lines):
    body = [line.split(",") for line in lines[400:430]]
    fixed = [[*cells[:4], f"{float(cells[3]) - 300:.2f}", "300"] for cells in body]
    return [*lines[:400], *(",".join(cells) for cells in fixed), *lines[430:]]


@pytest.mark.parametrize(
    ("change", "text", "line", "samples"),
    [
        (_stale_before_header, "stale row before the header", 1, 1500),
        (_stale_after_columns, "stale row", HEAD + 1, 1500),
        (_stale_in_place_of_the_first, "stale row", HEAD + 1, 1499),
        (_torn, "incomplete last line", HEAD + 1500, 1499),
        (_no_done, "without 'done'", HEAD + 1500, 1500),
        (_lost_lines, "states 1600 earlier lines", HEAD + 1501, 1500),
        (_cell("12x"), "pressureCommanded is not a number", 101, 1499),
        (_cell(""), "pressureCommanded is not a number", 101, 1499),
        (_cell("nan"), "pressureCommanded is not finite", 101, 1499),
        (_cell("1e9"), "outside", 101, 1499),
        (_cell("100.00"), "pressureError differs from pressureCommanded - pressure", 101, 1499),
        (_duplicate, "is repeated", 102, 1500),
        (_gap, "10 samples are missing", 101, 1490),
        (_wrong_stop, "implies 1550 samples", None, 1500),
        (_wrong_frequency, "the command has 1 Hz", None, 1500),
        (_unknown_header_line, "unknown header line", 2, 1500),
        (_stuck, "pressure stuck at 300 counts for 3", None, 1500),
    ],
)
def test_a_repaired_fault_is_a_finding(tmp_path, change, text, line, samples):
    log = read_log(write_log(tmp_path / "log.txt", change(log_lines())))
    matching = [x for x in log.findings if text in x.detail]
    assert matching, [str(x) for x in log.findings]
    assert matching[0].line == line
    assert len(log.t) == samples
    command, _ = lag_series()
    # A dropped row does not shift the other samples in time.
    first = 1 if change is _stale_in_place_of_the_first else 0
    place = np.round(log.t / 0.002).astype(int) + first
    np.testing.assert_allclose(log.command, command[place], atol=1e-9)


def _replaced(old, new):
    return lambda lines: [line.replace(old, new) for line in lines]


def _without(start):
    return lambda lines: [line for line in lines if not line.startswith(start)]


BAD = {
    "empty": (lambda lines: [], "is empty"),
    "binary": (lambda lines: ["\0\1\2"], "is not text"),
    "no columns": (_without("N_sample"), "no line of column names"),
    "unknown columns": (_replaced(",".join(COLUMNS), "t_s,p_rear_Pa"), "line 7: columns t_s"),
    "columns reordered": (
        _replaced("pressureError,pressure", "pressure,pressureError"),
        "line 7: columns",
    ),
    "no frequency": (_without("frequency"), "the header has no frequency"),
    "no period": (_without("Sample"), "the header has no period"),
    "frequency zero": (_replaced("1.000000 Hz", "0.0 Hz"), "line 2: frequency: given 0.0"),
    "frequency twice": (lambda lines: [lines[1], *lines], "line 3: a second frequency"),
    "two tests": (lambda lines: [*lines[:-1], *lines], "second line of column names"),
    "two tests, no columns": (
        lambda lines: [*lines[:-1], lines[1], *lines[HEAD:]],
        "a second test begins",
    ),
    "counter falls": (
        lambda lines: [*lines[:500], *lines[300:]],
        "line 501: N_sample decreases from 493 to 294",
    ),
    "long gap": (lambda lines: [*lines[:300], *lines[400:]], "line 301: 100 samples are missing"),
    "many bad rows": (
        lambda lines: lines[:HEAD] + [x.replace(",", ";") for x in lines[HEAD:200]] + lines[200:],
        "rows are bad",
    ),
    "few rows": (lambda lines: [*lines[: HEAD + 8], lines[-1]], "8 usable rows"),
    "header only": (lambda lines: lines[:HEAD], "0 usable rows"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_a_fault_that_cannot_be_repaired_is_refused(tmp_path, name):
    change, text = BAD[name]
    path = write_log(tmp_path / "log.txt", change(log_lines()), "\r" if name != "empty" else "")
    with pytest.raises(InputError) as caught:
        read_log(path)
    assert text in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("command", [["calibrate", "manifold"], ["simulate"]])
@pytest.mark.parametrize("name", ["empty", "unknown columns", "counter falls", "absent", "folder"])
def test_a_bad_log_ends_a_command_with_one_message_and_no_files(tmp_path, capsys, command, name):
    path = tmp_path / "log.txt"
    if name == "folder":
        path.mkdir()
    elif name != "absent":
        write_log(path, BAD[name][0](log_lines()), "\r" if name != "empty" else "")
    out = tmp_path / "out"
    assert main([*command, str(path), "--out", str(out)]) == 2
    text = capsys.readouterr().err
    assert text.startswith("slider: error: ") and text.count("\n") == 1
    assert str(path) in text
    assert not out.exists()


def test_a_log_given_twice_is_refused(tmp_path, capsys):
    path = str(write_log(tmp_path / "log.txt", log_lines()))
    assert main(["calibrate", "manifold", path, path, "--out", str(tmp_path / "out")]) == 2
    assert "give each log once" in capsys.readouterr().err


def test_the_rigs_logs_have_only_stale_rows_as_faults(data):
    logs = [read_log(path) for path in sorted((data / "manifold").glob("*.txt"))]
    assert len(logs) == 10
    assert sum(len(log.t) for log in logs) == 53312
    stale = [log.path.name for log in logs if any("stale" in x.detail for x in log.findings)]
    assert stale == ["1.1667.txt", "2.3889.txt"]
    assert all(len(log.findings) == (2 if log.path.name in stale else 0) for log in logs)
    assert all(abs(log.cycles - 10.0) < 0.02 for log in logs)
