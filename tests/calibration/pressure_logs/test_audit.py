"""The audit of the rig's logs: it distinguishes unequal codes from uneven signals."""

import numpy as np
import pytest

from calibration.pressure_logs.audit import audit_logs, code_density
from calibration.pressure_logs.read import PSI_PER_COUNT, read_log
from tests.support.synthetic_log import log_lines, write_log


def signals(seed, many=5, noise=1.7):
    """Returns unrounded pressures in counts, sines of several sizes as on the rig, and noises."""
    rng = np.random.default_rng(seed)
    found = []
    for i in range(many):
        t = 0.002 * np.arange(5000)
        drift = 3.0 * np.sin(2 * np.pi * rng.uniform(0.05, 0.2) * t + rng.uniform(0, 6))
        wave = (150.0 - 15.0 * i) * np.sin(2 * np.pi * (0.25 + 0.2 * i) * t + rng.uniform(0, 6))
        found.append(290.0 + wave + 0.1 * wave * np.abs(wave) / 100.0 + drift)
    return found, [noise * rng.normal(size=5000) for _ in found]


def even(seed, **keywords):
    quiet, noise = signals(seed, **keywords)
    return [np.round(x + n) for x, n in zip(quiet, noise, strict=True)]


def uneven(seed, period=31.0, error=1.5, **keywords):
    """Returns readings of a converter whose error is a sine of `error` counts over the codes."""
    quiet, noise = signals(seed, **keywords)
    read = []
    for x, n in zip(quiet, noise, strict=True):
        p = x + n
        read.append(np.round(p + error * np.sin(2 * np.pi * p / period)))
    return read


@pytest.mark.parametrize("seed", range(4))
def test_codes_of_equal_width_give_no_finding(seed):
    found = code_density(even(seed), nulls=10)
    assert not found.uneven and found.missing == []


@pytest.mark.parametrize("noise", [0.8, 4.0])
def test_equal_codes_with_other_noise_give_no_finding(noise):
    assert not code_density(even(9, noise=noise), nulls=10).uneven


@pytest.mark.parametrize(("period", "error"), [(31.0, 1.5), (20.0, 1.2), (12.0, 0.8)])
def test_unequal_codes_are_found_with_their_period_and_error(period, error):
    found = code_density(uneven(2, period, error), nulls=10)
    assert found.uneven and found.significance > 10.0
    assert found.period == pytest.approx(period, rel=0.05)
    assert found.inl == pytest.approx(error, rel=0.3)
    assert found.opposed < -0.8


def test_a_signal_with_steps_gives_no_finding():
    """Its density varies more than that of smooth signals, but its noise does not vary."""
    rng = np.random.default_rng(0)
    levels = np.repeat(140.0 + 31.0 * rng.integers(0, 10, size=7000), 3)
    found = code_density([np.round(levels + 6.0 * rng.normal(size=len(levels)))], nulls=10)
    assert found.amplitude > 1.5 * found.null.max()
    assert found.opposed > -0.8 and not found.uneven


def test_codes_that_are_never_read_are_listed():
    read = [np.where(x == 256.0, 257.0, x) for x in even(3)]
    found = code_density(read, nulls=2)
    assert found.missing == [256] and 256 in found.rare


def test_fractional_constant_or_absent_readings_have_no_code_density():
    assert code_density([np.linspace(0.0, 400.0, 5000) + 0.5], nulls=2) is None
    assert code_density([np.full(5000, 290.0)], nulls=2) is None
    assert code_density([], nulls=2) is None


def log(folder, change=lambda x: x, **keywords):
    return read_log(write_log(folder / "log.txt", change(log_lines(**keywords))))


def test_a_log_without_fault_gives_no_finding(tmp_path):
    assert audit_logs([log(tmp_path)]) == []


def test_the_repairs_of_the_reader_are_findings(tmp_path):
    found = audit_logs([log(tmp_path, lambda x: [*x[:100], x[99], *x[100:-1]])])
    assert sorted((x.kind, x.action) for x in found) == [
        ("log_row", "mended"), ("log_row", "used")
    ]  # fmt: skip
    assert any("is repeated" in x.detail for x in found)


def test_duties_from_another_row_are_a_finding(tmp_path):
    def late(lines):
        rows = [x.split(",") for x in lines[7:-1]]
        moved = [[r[0], *b[1:3], *r[3:]] for r, b in zip(rows[1:], rows[:-1], strict=True)]
        return [*lines[:7], ",".join(rows[0]), *(",".join(r) for r in moved), lines[-1]]

    assert [x.kind for x in audit_logs([log(tmp_path, late)])] == ["duty"]


def test_lost_samples_with_a_continuous_counter_are_a_finding(tmp_path):
    def lost(lines):
        rows = [x.split(",", 1)[1] for x in [*lines[7:500], *lines[505:-1]]]
        return [*lines[:7], *(f"{i},{x}" for i, x in enumerate(rows, start=1)), lines[-1]]

    assert "clock" in [x.kind for x in audit_logs([log(tmp_path, lost)])]


def test_a_clipped_pressure_is_a_finding(tmp_path):
    def clip(lines):
        rows = []
        for line in lines[7:-1]:
            n, _, _, c, _, p = line.split(",")
            p, c = min(float(p), 420.0), float(c)
            duty = int(min(250, 10 * abs(c - p)))
            fill, vent = (duty, 0) if c > p else (0, duty)
            rows.append(f"{n},{fill},{vent},{c:.2f},{c - p:.2f},{p:.0f}")
        return [*lines[:7], *rows, lines[-1]]

    found = audit_logs([log(tmp_path, clip)])
    assert "clipped" in [x.kind for x in found]


def test_the_rigs_logs_have_codes_of_unequal_width(data):
    logs = [read_log(path) for path in sorted((data / "manifold").glob("*.txt"))]
    found = audit_logs(logs)
    assert {x.kind for x in found} == {"log_row", "code_density"}
    assert sum("stale" in x.detail for x in found) == 2
    density = code_density([x.pressure for x in logs])
    assert density.uneven and density.significance > 30.0
    assert density.period == pytest.approx(31.2, abs=0.5)
    assert density.opposed < -0.9
    assert {140, 171, 203, 234 + 1, 266} & set(density.rare) >= {140, 171, 203, 266}
    assert 0.15 < density.inl * PSI_PER_COUNT < 0.25
    assert "31.2 counts" in next(x.detail for x in found if x.kind == "code_density")
