"""A drive as it was played stands for the one that was meant."""

import jax.numpy as jnp
import numpy as np
import pytest

from calibration.model.plan import Resolution, plan_trial
from calibration.model.predict import predict_readings
from slider_jax.actuation import FirstOrderLag, Held
from slider_jax.effects.pneumatics.valve_delay import ValveDelay
from slider_jax.errors import InputError
from slider_jax.experiment.load import load
from slider_jax.experiment.playback import read_played as read_played
from slider_jax.io.files import write_csv
from slider_jax.simulation.trial import simulate_trial
from tests.support.chambers import pressure_history
from tests.support.experiments import write_small_experiment

K, STEP = 0.087, 5e-4


def played(folder, t, front, rear, name="trial_00"):
    columns = {"t_s": t, "set_front_Pa": front, "set_rear_Pa": rear}
    write_csv(folder / f"{name}.played.csv", {k: np.asarray(v, float) for k, v in columns.items()})


def meant(trial, late=0.0):
    """Times and set pressures of the trial's square wave, every change `late` [s]; the end last."""
    f, A, duration = trial.frequency, trial.amplitude, trial.duration
    halves = np.arange(int(2 * f * duration) + 2)
    fronts, rears = 0.5 * halves / f, (0.5 * halves + trial.phase) / f
    t = np.unique(np.concatenate([[0.0], fronts, rears]))
    t = np.append(t[t < duration - late], duration)

    def at(t, phase):
        return A * np.where(np.floor(2.0 * (f * t - phase) + 1e-9) % 2 == 0, 1.0, -1.0)

    front, rear = at(t, 0.0), trial.rear_ratio * at(t, trial.phase)
    front[-1], rear[-1] = front[-2], rear[-2]
    moved = np.append(t[:-1] + late, duration)
    return (
        (moved, front, rear)
        if not late
        else (np.append(0.0, moved), np.append(0.0, front), np.append(0.0, rear))
    )


def lagged(at, t, sets, k=K):
    """Pressure (n,) in closed form, of set pressures that hold from the times `t` on."""
    found = np.zeros(len(at))
    for i, now in enumerate(at):
        p = 0.0
        for begin, end, a in zip(t, [*t[1:], np.inf], sets, strict=True):
            held = min(end, now) - begin
            if held <= 0.0:
                break
            p = a + (p - a) * np.exp(-held / k)
        found[i] = p
    return found


@pytest.mark.slow
def test_one_that_was_played_as_meant_changes_nothing(tmp_path):
    experiment = load(write_small_experiment(tmp_path)).with_values({"numerics.step": 2e-3})
    before = simulate_trial(experiment, 0).columns
    played(tmp_path, *meant(experiment.trials[0]))
    after = simulate_trial(experiment, 0).columns
    for name, x in before.items():
        np.testing.assert_allclose(after[name], x, atol=2e-9 * np.abs(x).max())


@pytest.mark.slow
def test_edges_are_where_they_were_played_between_steps_too(tmp_path):
    experiment = load(write_small_experiment(tmp_path)).with_values({"numerics.step": STEP})
    trial = experiment.trials[0]
    t, front, rear = meant(trial, late=1.7e-3)
    t[2] += 0.9e-3
    played(tmp_path, t, front, rear)
    found = simulate_trial(experiment, 0).columns
    laid = plan_trial(experiment, trial, (), Resolution(11, 40, 5e-3))
    fitted = predict_readings(laid, np.array([3.0, 1.0, K, 4.79e-7]))
    for i, (name, sets) in enumerate((("p_front_Pa", front), ("p_rear_Pa", rear))):
        exact = lagged(found["t_s"], t, sets)
        np.testing.assert_allclose(fitted[i], exact, atol=1e-5)
        # Between its steps the simulation is interpolated, an edge taken for on the nearest one.
        assert np.abs(found[name] - exact).max() < 2.0 * np.abs(sets).max() * 0.5 * STEP / K
        assert np.median(np.abs(found[name] - exact)) < 1.0
    np.testing.assert_allclose(read_played(experiment, trial).edges, t[1:-1], rtol=1e-8)


def test_the_chambers_follow_changes_that_are_closer_than_a_step(tmp_path):
    """Front and rear switch within one step of each other, as their phases have it."""
    experiment = load(write_small_experiment(tmp_path))
    t, front, rear = [0.0, 0.101, 0.1015, 0.75], [1e5, 1e5, -1e5, -1e5], [2e5, -2e5, -2e5, -2e5]
    played(tmp_path, t, front, rear)
    told = experiment.trials[0].model_copy(update={"amplitude": 1e5})
    drive = read_played(experiment, told).drive
    at = 0.005 * np.arange(140)
    for wave, sets in zip(drive.waves, (front, rear), strict=True):
        history = pressure_history(FirstOrderLag(jnp.asarray(K)), wave, 0.0, jnp.asarray(at))
        np.testing.assert_allclose(history, lagged(at, t, sets), atol=1e-6)


@pytest.mark.parametrize("delay", [0.0, 5e-3, 9.5e-3, 1.05e-2, 2.01e-2, 2.05e-2])
def test_a_dead_time_moves_a_first_edge_that_was_played_late(delay):
    """It falls into the same step as the dead time's own end, or not."""
    t, sets, at = np.array([0.0, 0.9e-3, 0.2]), np.array([0.0, 2e5, -2e5]), 2e-3 * np.arange(200)
    wave = ValveDelay(jnp.asarray(delay)).command(Held(jnp.asarray(t), jnp.asarray(sets)), 0)
    history = pressure_history(FirstOrderLag(jnp.asarray(K)), wave, 0.0, jnp.asarray(at))
    np.testing.assert_allclose(history, lagged(at, np.append(0.0, t[1:] + delay), sets), atol=1e-6)


@pytest.mark.parametrize("rate", [200.0, 500.0, 1000.0])
def test_a_smooth_drive_is_followed_at_any_rate_of_commands(tmp_path, rate):
    experiment = load(write_small_experiment(tmp_path)).with_values({"trials.0.waveform": "sine"})
    t = np.append(np.arange(0.0, 0.7499, 1.0 / rate), 0.75)
    sets = 1.5e5 * np.sin(2 * np.pi * 4.0 * t)
    played(tmp_path, t, sets, sets)
    drive = read_played(experiment, experiment.trials[0]).drive
    at = 2.5e-3 * np.arange(298)
    history = pressure_history(FirstOrderLag(jnp.asarray(K)), drive.waves[0], 0.0, jnp.asarray(at))
    assert np.abs(history - lagged(at, t, sets)).max() < (1e-3 if rate == 200.0 else 250.0)
    assert read_played(experiment, experiment.trials[0]).edges is None


@pytest.mark.slow
def test_forces_do_not_mind_where_between_steps_an_edge_falls(tmp_path):
    experiment = load(write_small_experiment(tmp_path)).with_values(
        {"numerics.nodes": 21, "numerics.step": 2e-3}
    )
    fine = experiment.with_values({"numerics.step": 2.5e-4})
    errors = []
    for late in (2e-3, 0.75e-3, 1.25e-3):
        played(tmp_path, *meant(experiment.trials[0], late))
        rough, exact = (simulate_trial(x, 0).columns["recoil_N"] for x in (experiment, fine))
        errors.append((rough - exact) / exact.std())
    # 1.5 mN of 0.5 N is the step's own, wherever edges fall.
    assert max(np.std(x) for x in errors) < 1.25 * min(np.std(x) for x in errors) < 0.005
    assert max(np.abs(x).max() for x in errors) < 0.03


def test_a_trial_of_which_nothing_is_told_is_driven_as_meant(tmp_path):
    experiment = load(write_small_experiment(tmp_path))
    played(tmp_path, *meant(experiment.trials[0], late=2e-3))
    assert read_played(experiment, experiment.trials[1]) is None
    late, declared = (
        simulate_trial(experiment, 0, declared_drive=x).columns for x in (False, True)
    )
    assert np.abs(late["p_front_Pa"] - declared["p_front_Pa"]).max() > 1e3


@pytest.mark.parametrize(
    ("t", "front", "said"),
    [
        ([0.0, 0.1, 0.7], [1e5] * 3, "0 to 0.7 s, but the trial trial_00.csv lasts from 0 to 0.75"),
        ([0.1, 0.2, 0.75], [1e5] * 3, "covers 0.1 to 0.75 s"),
        ([0.0, 0.1, 0.75], [100.0] * 3, "given a largest value of 100; allowed 0, or peaks of"),
        (
            [0.0, 0.1, 0.75],
            [1e5] * 3,
            "amplitude is 100000 Pa, but 150000 Pa in the trial trial_00.csv",
        ),
        ([0.0, 0.0, 0.75], [1e5] * 3, "time must increase from row to row"),
    ],
)
def test_a_file_that_cannot_be_is_refused(tmp_path, t, front, said):
    experiment = load(write_small_experiment(tmp_path))
    played(tmp_path, t, front, front)
    with pytest.raises(InputError, match=said.replace("(", r"\(")):
        simulate_trial(experiment, 0)
