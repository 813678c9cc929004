"""Synthetic tank experiments, made in numpy, and functions that damage their files."""

from pathlib import Path

import numpy as np

from calibration.audit.audit import audit_measurements
from calibration.measurements.synthetic import ROBOT, START, slow_noise
from slider_jax.channels import SLIDER_CHANNELS
from slider_jax.experiment import load as experiment
from slider_jax.io.files import write_csv, write_text

RATE = 250.0
QUANTUM = 932.8
K = 0.085
RUNS = [  # frequency, amplitude, phase, tow speed, duration
    (1.0, 330e3, 0.15, 0.0, 3.0),
    (1.3, 250e3, -0.1, 0.22, 2.4),
    (1.6, 330e3, 0.0, 0.0, 2.0),
    (2.2, 150e3, 0.3, 0.22, 1.6),
    (3.0, 250e3, 0.15, 0.0, 1.5),
    (3.8, 330e3, 0.15, 0.22, 1.5),
    (4.8, 250e3, 0.0, 0.0, 1.5),
    (6.0, 150e3, 0.3, 0.22, 1.5),
]
CAMERA_EVERY = 4
ROW = {"p_front": 0, "p_rear": 1, "thrust": 2, "recoil": 3, "tip": 4}


def lagged_square(t, frequency, phase, k=K, delay=0.0):
    """Returns a lag's response to a square wave from rest, by small explicit steps."""
    h = 2e-4
    fine = np.arange(0.0, t[-1] + 2.0 * h, h)
    turn = frequency * (fine - delay + 0.5 * h) - phase
    goal = np.where(fine >= delay, np.where(np.floor(2.0 * turn) % 2 == 0, 1.0, -1.0), 0.0)
    series = [0.0]
    for x in goal[:-1].tolist():
        series.append(series[-1] + h / k * (x - series[-1]))
    return np.interp(t, fine, series)


def quiet(run, gain=1.0, delay=0.0, k=K):
    """Returns times and readings (5, n) without noise, with simple laws for forces and tip.

    Recoil and tip follow the pressures, at the drive's frequency; thrust follows their squares.
    """
    f, amplitude, phase, tow, duration = run
    t = np.arange(round(duration * RATE) + 1) / RATE
    front = gain * amplitude * lagged_square(t, f, 0.0, k, delay)
    rear = gain * 0.9 * amplitude * lagged_square(t, f, phase, k, delay)
    follow = 1.0 - np.exp(-1.0 / RATE / 0.03)
    bend, speed = np.zeros(len(t)), np.zeros(len(t))
    for i in range(1, len(t)):
        bend[i] = bend[i - 1] + follow * ((0.6 * front + 0.4 * rear)[i] / 3e5 - bend[i - 1])
        speed[i] = RATE * (bend[i] - bend[i - 1])
    thrust = 0.02 * (speed**2 - 8.0) / (1.0 + 0.5 * tow)
    recoil = 0.5 * bend + 0.06 * speed
    return t, np.stack([front, rear, thrust, recoil, 0.06 * bend / (1.0 + 0.3 * f)])


def readings(run, seed, **physics):
    """Returns times (n,) and readings (5, n) with noise and quantisation."""
    t, true = quiet(run, **physics)
    rng, n = np.random.default_rng(seed), len(t)
    values = true.copy()
    for row in (0, 1):
        noisy = true[row] + 700.0 * rng.normal(size=n)
        values[row] = np.round(np.round(noisy / QUANTUM) * QUANTUM)
    for row in (2, 3):
        noise = 0.02 * rng.normal(size=n) + 0.01 * slow_noise(t, 0.1, rng) + 0.01 * rng.normal()
        values[row] = np.round((1.0 + 0.01 * rng.normal()) * true[row] + noise, 4)
    tip = np.round(true[4] + 5e-4 * rng.normal(size=n), 5)
    values[4] = np.where(np.arange(n) % CAMERA_EVERY == 0, tip, np.nan)
    return t, values


def write_experiment(folder: Path, seed: int = 0, runs=RUNS, **physics) -> Path:
    """Writes an experiment file and its trials; returns the file's path."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = ['name = "made up"', "[robot]"]
    lines += [f"{key} = {value}" for key, value in ROBOT.items()]
    lines += ["[parameters]", *(f"{key} = {value}" for key, value in START.items())]
    lines += ["[sensors]", "pressure_noise = 700.0", "force_noise = 0.02", "force_tare = 0.01"]
    lines += ["force_slow_noise = 0.01", "tip_noise = 5e-4", f"sample_rate = {RATE}"]
    for i, run in enumerate(runs):
        f, amplitude, phase, tow, duration = run
        lines += ["[[trials]]", f'file = "trial_{i:02d}.csv"', f"frequency = {f}"]
        lines += [f"amplitude = {amplitude}", "rear_ratio = 0.9", f"phase = {phase}"]
        lines += [f"tow_speed = {tow}", f"duration = {duration}"]
        t, values = readings(run, 100 * seed + i, **physics)
        save(folder / f"trial_{i:02d}.csv", t, values)
    write_text(folder / "experiment.toml", "\n".join(lines) + "\n")
    return folder / "experiment.toml"


def save(path: Path, t, values) -> None:
    """Writes a trial's file."""
    formats = {"t_s": ".6g", "p_front_Pa": ".9g", "p_rear_Pa": ".9g"}
    write_csv(path, dict(zip(SLIDER_CHANNELS.columns, [t, *values], strict=True)), formats)


def read(path: Path):
    """Returns times (n,) and values (5, n) of an undamaged file."""
    rows = [line.split(",") for line in path.read_text().splitlines()[1:]]
    table = np.array([[float(cell or "nan") for cell in row] for row in rows])
    return table[:, 0], table[:, 1:].T.copy()


_QUIET: dict[str, tuple] = {}


def predict(records):
    """Returns the prediction (5, n) of records by a model with slightly wrong parameters."""
    found = []
    for r in records:
        if r.trial.file not in _QUIET:
            run = RUNS[int(r.trial.file[6:8])]
            _QUIET[r.trial.file] = quiet(run, gain=0.9, k=0.07)
        t, values = _QUIET[r.trial.file]
        found.append(np.stack([np.interp(r.t, t, y) for y in values]))
    return found


def audited(folder, least=3):
    return audit_measurements(experiment.load(folder / "experiment.toml"), least, predict)


def alter(folder, number, change):
    """Replaces a trial's times and values by the result of `change(t, values)`."""
    path = folder / f"trial_{number:02d}.csv"
    save(path, *change(*read(path)))


def lines_of(folder, number, change):
    path = folder / f"trial_{number:02d}.csv"
    path.write_text("\n".join(change(path.read_text().splitlines())) + "\n")


def kinds(found, number=None):
    name = None if number is None else f"trial_{number:02d}.csv"
    return [(x.kind, x.channel, x.action) for x in found.findings if name in (None, x.trial)]


def only(found, number, *expected):
    """Asserts that the audit has only the expected findings, all on one trial."""
    assert kinds(found, number) == list(expected)
    assert len(found.findings) == len(expected), [str(x) for x in found.findings]


def record(found, number):
    return next(r for r in found.records if r.trial.file == f"trial_{number:02d}.csv")


def same_as_whole(found, whole, number, row=slice(None)):
    t, values = read(whole / f"trial_{number:02d}.csv")
    r = record(found, number)
    np.testing.assert_allclose(r.t, t, atol=1e-5)
    np.testing.assert_allclose(r.values[row], values[row], rtol=1e-5)
