"""Experiment files: what is read, the models of their trials, what a model file changes."""

import jax
import numpy as np
import pytest

from slider_jax import paper
from slider_jax.actuation import Ideal, Recorded, SineWave, Trapezoid
from slider_jax.errors import InputError
from slider_jax.experiment.load import (
    drag_and_added_mass,
    load,
    read_measured,
    to_model,
    to_numerics,
)
from slider_jax.experiment.prepare import prepare
from tests.support.experiments import write_small_experiment


def test_every_number_of_the_file_reaches_the_model(tmp_path):
    experiment = load(write_small_experiment(tmp_path))
    model = to_model(experiment, 0)
    robot, drive = model.robot, model.drive
    drag, reactive = model.effects
    pairs = [
        ((robot.body.length, robot.tail.length), (0.3, 0.07)),
        ((robot.body.linear_density, robot.tail.linear_density), (0.7, 0.7)),
        ((robot.body.EI, robot.tail.EI), (0.038, 0.0058)),
        ((robot.body.EA, robot.tail.EA), (1e5, 1e5)),
        ((robot.body.damping_time, robot.tail.damping_time), (0.002, 0.002)),
        ((robot.body.height, robot.tail.height), (0.03, 0.03)),
        (robot.chambers[0], (0.02, 0.145)),
        (robot.chambers[1], (0.155, 0.28)),
        (robot.K_Q, 4.79e-7),
        ((drag.C_d, drag.density), (3.0, 1000.0)),
        ((reactive.m_a, reactive.density), (1.0, 1000.0)),
        (model.pressure_law.k, 0.087),
        (
            (drive.waves[0].frequency, drive.waves[0].amplitude, drive.waves[0].phase),
            (4.0, 1.5e5, 0.0),
        ),
        (
            (drive.waves[1].frequency, drive.waves[1].amplitude, drive.waves[1].phase),
            (4.0, 1.35e5, 0.1),
        ),
        (to_model(experiment, 1).support.tow_speed, 0.2),
    ]
    for found, expected in pairs:
        np.testing.assert_allclose(found, expected, rtol=1e-15)
    assert to_numerics(experiment)[0].nodes == 11
    assert all(leaf.dtype == np.float64 for leaf in jax.tree.leaves(model))


def test_trials_of_one_waveform_share_their_structure(tmp_path):
    experiment = load(write_small_experiment(tmp_path))
    first, second = (jax.tree.structure(to_model(experiment, i)) for i in (0, 1))
    assert first == second


@pytest.mark.parametrize(
    "text, kind", [('waveform = "sine"', SineWave), ('waveform = "trapezoid"', Trapezoid)]
)
def test_waveforms(text, kind, tmp_path):
    drive = to_model(
        load(write_small_experiment(tmp_path, ("phase = 0.1", f"phase = 0.1\n{text}")))
    ).drive
    assert isinstance(drive.waves[0], kind) and isinstance(drive.waves[1], kind)
    np.testing.assert_allclose((drive.waves[0].phase, drive.waves[1].phase), (0.0, 0.1))


def test_recorded_drive_as_set_and_as_measured_pressure(tmp_path):
    t = np.arange(0.0, 0.76, 0.01)
    rows = [f"{a:.2f},{1e5 * np.sin(a) + 5.0},{-1e5 * a}" for a in t]
    (tmp_path / "drive.csv").write_text("\n".join(["t_s,p_front_Pa,p_rear_Pa", *rows]))
    old = "frequency = 4.0\namplitude = 150000.0"
    new = 'waveform = "recorded"\ndrive_file = "drive.csv"'
    lagging = to_model(load(write_small_experiment(tmp_path, (old, new))))
    assert isinstance(lagging.drive.waves[0], Recorded)
    np.testing.assert_allclose(lagging.drive.waves[1].values, -1e5 * t)
    assert lagging.drive.start[0] == 0.0 and lagging.pressure_law.k == 0.087
    direct = to_model(
        load(write_small_experiment(tmp_path, (old, f'{new}\ndrive_is = "measured"')))
    )
    assert isinstance(direct.pressure_law, Ideal)
    np.testing.assert_allclose(direct.drive.start[0], 5.0)


def test_a_recorded_drive_need_not_begin_at_zero(tmp_path):
    """The first sample holds before it; a record from before the start is entered at t = 0."""
    old = "frequency = 4.0\namplitude = 150000.0"
    new = 'waveform = "recorded"\ndrive_file = "drive.csv"\ndrive_is = "measured"'
    path = write_small_experiment(tmp_path, (old, new))
    for first in (0.008, -0.025):
        t = first + np.arange(0.0, 0.8, 0.01)
        rows = [f"{a:.3f},{1e5 + 1e6 * a},{-1e5}" for a in t]
        (tmp_path / "drive.csv").write_text("\n".join(["t_s,p_front_Pa,p_rear_Pa", *rows]))
        drive = to_model(load(path)).drive
        begin = 1e5 + 1e6 * max(first, 0.0)
        np.testing.assert_allclose(drive.start, (begin, -1e5))
        segment = drive.waves[0].segment(np.asarray(0.0), np.asarray(0.004))
        np.testing.assert_allclose(segment.a0, begin)
        np.testing.assert_allclose(segment.b1, begin if first > 0.0 else begin + 4e3)


RAMP = ("C_d = 3.0\nm_a = 1.0", 'force_coefficients = "ramp"')


@pytest.mark.parametrize("frequency", [1.0, 2.0, 2.4, 3.0, 4.8])
def test_the_ramp_gives_what_the_demo_takes(frequency, tmp_path):
    experiment = load(
        write_small_experiment(tmp_path, RAMP, ("frequency = 4.0", f"frequency = {frequency}"))
    )
    drag, reactive = to_model(experiment, 0).effects
    drag_of_demo, reactive_of_demo = paper.head_fixed(frequency).effects
    assert (drag.C_d, reactive.m_a) == (drag_of_demo.C_d, reactive_of_demo.m_a)
    # The other trial keeps its own frequency, and so its own coefficients.
    assert drag_and_added_mass(experiment, experiment.trials[1]) == (3.5, 0.5)


def test_a_model_file_replaces_the_ramp_and_the_numbers(tmp_path):
    model = tmp_path / "model.toml"
    model.write_text("[parameters]\nC_d = 2.0\nm_a = 0.7\n")
    parameters = load(write_small_experiment(tmp_path, RAMP), model).parameters
    assert (parameters.force_coefficients, parameters.C_d, parameters.m_a) == ("fixed", 2.0, 0.7)
    model.write_text('[parameters]\nforce_coefficients = "ramp"\n')
    parameters = load(write_small_experiment(tmp_path), model).parameters
    assert (parameters.force_coefficients, parameters.C_d, parameters.m_a) == ("ramp", None, None)


def test_the_ramp_needs_a_frequency(tmp_path):
    recorded = 'waveform = "recorded"\ndrive_file = "drive.csv"'
    path = write_small_experiment(
        tmp_path, RAMP, ("frequency = 4.0\namplitude = 150000.0", recorded)
    )
    with pytest.raises(InputError, match='trials.0.frequency: given nothing; .*"ramp"'):
        load(path)


def test_model_file_overrides_and_adds(tmp_path):
    path, model = write_small_experiment(tmp_path), tmp_path / "model.toml"
    model.write_text(
        '[robot]\nEI_tail = 0.007\n[parameters]\nk = 0.05\n[[effects]]\nname = "gravity"\ng = 0.5\n'
    )
    base, changed = load(path), load(path, model)
    assert changed.robot.EI_tail == 0.007 and changed.parameters.k == 0.05
    assert changed.robot.EI_body == base.robot.EI_body and changed.trials == base.trials
    effects = to_model(changed).effects
    assert len(effects) == 3 and effects[2].g == 0.5
    assert changed.folder == path.parent


def test_with_values_is_validated(tmp_path):
    experiment = load(write_small_experiment(tmp_path))
    changed = experiment.with_values({"trials.1.frequency": 3.0, "parameters.C_d": 2.0})
    assert changed.trials[1].frequency == 3.0 and changed.parameters.C_d == 2.0
    assert experiment.trials[1].frequency == 2.5 and changed.folder == experiment.folder
    with pytest.raises(InputError, match="trials.1.frequency: given -3.0; allowed 0.05 to 20 Hz"):
        experiment.with_values({"trials.1.frequency": -3.0})
    with pytest.raises(InputError, match="robot.mass: no such field"):
        experiment.with_values({"robot.mass": 1.0})
    with pytest.raises(InputError, match="trials.7.phase: no such field"):
        experiment.with_values({"trials.7.phase": 0.0})


def test_sample_times_are_the_records_own_or_the_sensors_rate(tmp_path):
    experiment = load(write_small_experiment(tmp_path))
    np.testing.assert_allclose(prepare(experiment).sample_times, np.arange(376) / 500)
    own = np.cumsum([0.0, 0.0020, 0.0021, 0.0019, 0.0020])
    text = "\n".join(["t_s,tip_m", *(f"{t},{'' if i % 2 else t}" for i, t in enumerate(own))])
    (tmp_path / "trial_00.csv").write_text(text.replace("\n", "\r\n"))
    np.testing.assert_allclose(prepare(experiment).sample_times, own)
    columns = read_measured(experiment, experiment.trials[0])
    np.testing.assert_array_equal(np.isnan(columns["tip_m"]), [False, True, False, True, False])
    assert read_measured(experiment, experiment.trials[1]) is None


def test_every_experiment_of_the_measured_data_loads(data):
    paths = sorted(data.glob("*/*/experiment.toml"))
    assert len(paths) >= 10
    for path in paths:
        experiment = load(path)
        for trial in experiment.trials:
            assert read_measured(experiment, trial)["t_s"][0] == 0.0
            to_model(experiment, trial)
