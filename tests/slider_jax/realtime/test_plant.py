"""Tests of the real-time plant: agreement with a whole simulation, faults, noise and errors."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.actuation import FirstOrderLag, SquareWave
from slider_jax.effects.library import LIBRARY
from slider_jax.effects.pneumatics.regulator_gain import RegulatorGain
from slider_jax.errors import InputError
from slider_jax.experiment.drive import delays_of, ratios_of
from slider_jax.experiment.load import load
from slider_jax.realtime.causality import Held, check_commands
from slider_jax.realtime.plant import Plant
from slider_jax.simulation.trial import simulate_trial
from tests.support.chambers import pressure_history
from tests.support.experiments import write_small_experiment

H = 0.005
"""Step of the small experiment [s]; half a stride is a whole number of them in both trials."""
VENT = [None] * 4
MIXED = {
    # command, flow, acting pressure
    "valve_delay": {"delay": 0.0123},
    "valve_deadband": {"band": 2e4},
    "line_lag": {"tau": 0.02},
    # body, mounting
    "tail_stiffness": {"x": 0.4},
    "stress_relaxation": {"E_1": 0.01},
    "sway_compliance": {"compliance": 2e-4},
    # water
    "head_drag": {"area": 1e-3},
    "tank_seiche": {"a_sin": 0.02},
    # instruments
    "pressure_sensor_lag": {"tau": 0.02},
    "pressure_offset": {"offset": 5e3},
    "force_resonance": {"mass_over_stiffness": 5e-5},
    "force_sensor_lag": {"tau": 0.01},
    "camera_delay": {"delay": 0.033},
}
MOVING = ("tow_speed = 0.0", "tow_speed = 0.1\nheave = 0.03\npitch = 0.1")


def tables(effects):
    """Returns the change to the small experiment's text that adds effects with their parameters."""
    lines = []
    for name, values in effects.items():
        lines += ["[[effects]]", f'name = "{name}"', *(f"{k} = {v}" for k, v in values.items())]
    return "[[trials]]", "\n".join([*lines, "[[trials]]"])


def set_pressures(plant, experiment, trial, steps):
    """Returns a controller's set pressures (steps, chambers) at the start of each step of H.

    The waves are not cut off at the limits of the actuators, because the plant does this.
    """
    middle = (jnp.arange(float(steps)) + 0.5) * H
    count = len(experiment.chambers)
    both = zip(ratios_of(trial, count), delays_of(trial, count), strict=True)
    waves = [SquareWave(trial.frequency, trial.amplitude * ratio, delay) for ratio, delay in both]
    signed = [jax.vmap(lambda t, w=w: w.segment(t, t + 1e-6).a0)(middle).tolist() for w in waves]
    rows = [
        [max(-p, 0.0) if right else max(p, 0.0) for p in signed[row]]
        for row, right in plant.chambers.values()
    ]
    return list(zip(*rows, strict=True))


def assert_equals_the_simulation(plant, experiment, trial, rtol=1e-10):
    run = simulate_trial(experiment, trial)
    assert run.grid.h == pytest.approx(H, rel=1e-12)
    readings = [plant.begin(trial)]
    for asked in set_pressures(plant, experiment, run.trial, run.grid.steps):
        readings.append(plant.advance(asked, H))
    assert readings[-1].ok
    np.testing.assert_allclose([x.t for x in readings], run.t, atol=1e-12)
    found = {
        **{
            f"p_{name}": [x.signed[i] for x in readings]
            for i, name in enumerate(experiment.chamber_names)
        },
        "thrust": [x.thrust_N for x in readings],
        "recoil": [x.recoil_N for x in readings],
        "tip": [x.tip_m for x in readings],
    }
    for name, values in found.items():
        scale = np.ptp(run.series[name])
        assert scale > 0.0
        np.testing.assert_allclose(values, run.series[name], rtol=0.0, atol=rtol * scale)


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """Returns the small experiment with a moving clamp in its first trial, and its plant."""
    experiment = load(write_small_experiment(tmp_path_factory.mktemp("plain"), MOVING))
    return experiment, Plant(experiment, step=H)


@pytest.fixture
def plant(plain):
    """Returns the plant at the start of the second trial, without faults."""
    _, plant = plain
    plant.begin(1)
    yield plant
    for name in [*(f"leak_{c}" for c in CHAMBERS), *(f"blocked_{c}" for c in CHAMBERS)]:
        plant.inject(name, 0.0)
    plant.inject("EI_tail", 0.0058)


CHAMBERS = ("front_left", "front_right", "rear_left", "rear_right")


@pytest.mark.parametrize("trial", [0, 1])
def test_a_plant_driven_sample_by_sample_equals_the_simulation(plain, trial):
    experiment, plant = plain
    assert_equals_the_simulation(plant, experiment, trial)


def other_chambers(*actuators):
    """Returns the changes to the small experiment's text that replace its two pairs of chambers.

    An actuator is its name and further lines.
    """
    spans = np.linspace(0.02, 0.28, len(actuators) + 1).tolist()
    listed = [
        f'[[actuators]]\nkind = "pneumatic"\nname = "{name}"\nspan = [{near}, {far}]\n{more}\n'
        for (name, more), near, far in zip(actuators, spans[:-1], spans[1:], strict=True)
    ]
    pairs = "front_chamber = [0.02, 0.145]\nrear_chamber = [0.155, 0.28]\n"
    return (pairs, ""), ("[sensors]", "\n".join([*listed, "[sensors]"]))


OWN_WAVES = ("rear_ratio = 0.9\nphase = 0.1", "ratios = [1.0, 0.8, 0.9]\nphases = [0.0, 0.1, 0.2]")


@pytest.mark.slow
def test_a_plant_with_three_pairs_equals_the_simulation(tmp_path):
    """Also the limit of an actuator, its own lag, and an effect on the sensor of each pressure."""
    three = other_chambers(("head", "limit = 1.4e5"), ("middle", "k_ratio = 1.3"), ("rear", ""))
    sensor = tables({"pressure_sensor_lag": {"tau": 0.02}})
    experiment = load(write_small_experiment(tmp_path, *three, OWN_WAVES, sensor))
    plant = Plant(experiment, step=H)
    assert list(plant.chambers) == [
        *("head_left", "head_right", "middle_left", "middle_right", "rear_left", "rear_right")
    ]
    assert_equals_the_simulation(plant, experiment, 0)
    plant.inject("leak_middle_right", 4.0)
    held = plant.advance([None, None, 2e4, 6e4, None, None], 3.0)
    leaking = 2e4 + 4e4 / (1.0 + 4.0 * 1.3 * 0.087)
    np.testing.assert_allclose(held.pressures, [0.0, 0.0, 2e4, leaking, 0.0, 0.0], atol=1.0)
    np.testing.assert_allclose(held.signed, [0.0, 2e4 - leaking, 0.0], atol=1.0)


@pytest.mark.slow
def test_a_plant_with_single_chambers_equals_the_simulation(tmp_path):
    single = other_chambers(("fin", 'side = "left"'), ("belly", 'side = "right"'))
    experiment = load(write_small_experiment(tmp_path, *single))
    plant = Plant(experiment, step=H)
    assert list(plant.chambers) == ["fin", "belly"]
    assert_equals_the_simulation(plant, experiment, 0)
    plant.begin(0)
    plant.inject("blocked_belly", 1.0)
    blocked = plant.advance([1e5, 1e5], 2.0)
    np.testing.assert_allclose(blocked.pressures, [1e5, 0.0], atol=1.0)
    plant.inject("blocked_belly", 0.0)
    filled = plant.advance([1e5, 1e5], 2.0)
    np.testing.assert_allclose(filled.signed, [1e5, -1e5], atol=1.0)
    with pytest.raises(InputError, match="set pressures: given 4 values; allowed 2, one for each "):
        plant.advance(VENT, H)
    with pytest.raises(InputError, match="fault: .*leak_belly_left"):
        plant.inject("leak_belly_left", 1.0)


@pytest.mark.slow
def test_effects_of_every_place_act_as_in_the_simulation(tmp_path):
    experiment = load(write_small_experiment(tmp_path, MOVING, tables(MIXED)))
    assert {LIBRARY[name].place() for name in MIXED} == {
        effect.place() for effect in LIBRARY.values()
    }
    assert_equals_the_simulation(Plant(experiment, step=H), experiment, 0)


@pytest.mark.slow
# The plant refuses `drive_clock`: the valves would be late by more and more.
@pytest.mark.parametrize("name", [name for name in LIBRARY if name != "drive_clock"])
def test_each_effect_acts_as_in_the_simulation(name, tmp_path):
    priors = LIBRARY[name].priors()
    given = {key: 0.4 * p.low + 0.6 * p.high for key, p in priors.items()}
    experiment = load(write_small_experiment(tmp_path, tables({name: given})))
    assert_equals_the_simulation(Plant(experiment, 1, step=H), experiment, 1)


def test_nothing_is_traced_while_the_plant_runs(plant):
    with jax.no_tracing():
        plant.advance([1e5, None, None, 1e5], 5 * H)
        plant.inject("leak_front_left", 1.0)
        plant.inject("EI_tail", 0.004)
        plant.advance([None, 1e5, 1e5, None], 5 * H)
        plant.begin(0, settle=0.1)


def test_time_advances_in_whole_steps_for_any_sequence_of_calls(plant):
    asked = [1e5, 0.0, 0.0, 8e4]
    whole = plant.advance(asked, 12 * H)
    assert whole.t == pytest.approx(12 * H) and abs(whole.tip_m) > 1e-4
    plant.begin(1)
    for _ in range(36):
        last = plant.advance(asked, H / 3)
    assert last.t == whole.t and last.tip_m == whole.tip_m and last.recoil_N == whole.recoil_N
    assert plant.advance(asked, 0.9 * H) == last


def test_after_settling_the_time_is_zero_and_the_clamp_has_its_initial_phase(plain):
    """The readings of a vented, heaving body repeat after a whole number of periods."""
    _, plant = plain
    settled = plant.begin(0, settle=2.0)
    assert settled.t == 0.0
    plant.begin(0)
    later = plant.advance(VENT, 2.0)
    assert later.t == pytest.approx(2.0) and abs(later.recoil_N) > 0.01
    for name in ("thrust_N", "recoil_N", "tip_m"):
        assert getattr(settled, name) == pytest.approx(getattr(later, name), rel=1e-9)


def test_chambers_fill_and_vent_with_the_lag(plant):
    k = 0.087
    filled = plant.advance([1e5, None, None, 5e4], 0.1)
    share = -np.expm1(-0.1 / k)
    np.testing.assert_allclose(filled.pressures, [1e5 * share, 0, 0, 5e4 * share], rtol=1e-9)
    assert filled.signed == (filled.pressures[0], -filled.pressures[3])
    vented = plant.advance(VENT, 0.2)
    np.testing.assert_allclose(
        vented.pressures, np.multiply(filled.pressures, np.exp(-0.2 / k)), rtol=1e-9
    )


def test_the_common_pressure_of_two_chambers_does_not_bend_the_body(plant):
    plant.begin(1)
    alone = plant.advance([6e4, None, None, None], 0.3)
    plant.begin(1)
    both = plant.advance([9e4, 3e4, 2e4, 2e4], 0.3)
    shared = -np.expm1(-0.3 / 0.087)
    np.testing.assert_allclose(
        both.pressures, [9e4 * shared, 3e4 * shared, 2e4 * shared, 2e4 * shared], rtol=1e-9
    )
    assert both.tip_m == pytest.approx(alone.tip_m, rel=1e-12) and abs(alone.tip_m) > 1e-3


def test_a_leak_lowers_the_pressure_of_its_chamber_until_the_flows_balance(plant):
    """The final pressure is p_set/(1 + q k). The other chambers keep their set pressures."""
    plant.advance([1e5, None, 8e4, None], 1.5)
    plant.inject("leak_front_left", 4.0)
    leaking = plant.advance([1e5, None, 8e4, None], 1.5)
    np.testing.assert_allclose(
        leaking.pressures, [1e5 / (1.0 + 4.0 * 0.087), 0.0, 8e4, 0.0], rtol=1e-6
    )
    other_side = plant.advance([None, 1e5, 8e4, None], 1.5)
    np.testing.assert_allclose(other_side.pressures, [0.0, 1e5, 8e4, 0.0], rtol=1e-6)
    plant.inject("leak_front_left", 0.0)
    repaired = plant.advance([1e5, None, 8e4, None], 1.5)
    np.testing.assert_allclose(repaired.pressures, [1e5, 0.0, 8e4, 0.0], rtol=1e-6)


def test_a_blocked_chamber_does_not_fill_but_vents(plant):
    held = plant.advance([1e5, None, None, None], 0.05)
    plant.inject("blocked_front_left", 1.0)
    blocked = plant.advance([1e5, None, None, None], 0.5)
    assert blocked.signed[0] == pytest.approx(held.signed[0], rel=1e-6)
    reversed_ = plant.advance([None, 1e5, None, None], 1.5)
    assert reversed_.signed[0] == pytest.approx(-1e5, rel=1e-6)
    assert plant.advance([1e5, None, None, None], 2.0).signed[0] == pytest.approx(0.0, abs=1.0)


def test_a_changed_tail_equals_an_experiment_with_that_tail(plain, tmp_path):
    experiment, plant = plain
    softer = load(write_small_experiment(tmp_path, MOVING, ("EI_tail = 0.0058", "EI_tail = 0.002")))
    plant.inject("EI_tail", 0.002)
    assert_equals_the_simulation(plant, softer, 1)
    plant.inject("EI_tail", 0.0058)
    assert_equals_the_simulation(plant, experiment, 1)


def test_the_tail_stiffness_may_change_during_a_stroke(plant):
    asked = [1e5, None, None, 1e5]
    whole = plant.advance(asked, 0.2)
    plant.begin(1)
    plant.advance(asked, 0.1)
    plant.inject("EI_tail", 0.002)
    changed = plant.advance(asked, 0.1)
    assert changed.ok and abs(changed.recoil_N - whole.recoil_N) > 0.02 * abs(whole.recoil_N)


def test_after_a_failed_step_the_last_reading_is_held_until_begin(plant):
    before = plant.advance([1e5, None, None, None], 2 * H)
    for _ in range(200):
        after = plant.advance([1e9, None, None, 1e9], H)
        if not after.ok:
            break
        before = after
    assert plant.failed_at == pytest.approx(before.t + H)
    assert after == before._replace(ok=False)
    assert plant.advance(VENT, 1.0) == after
    assert plant.begin(1).ok and plant.failed_at is None
    assert plant.advance(VENT, H).ok


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("force_clock_offset", -0.01),  # needs future samples
        ("camera_delay", 0.3),  # needs samples older than those kept
        ("camera_delay", 0.5 * H),  # the cubic interpolation needs the next sample
        ("valve_delay", -0.01),
        ("rear_valve_delay", 0.3),
        ("drive_clock", 0.001),  # after an hour, the valves are late by 3.6 s
        ("drive_clock", -0.001),
    ],
)
def test_an_effect_that_needs_future_values_is_rejected_with_its_name(name, value, tmp_path):
    key = "slow" if name == "drive_clock" else "delay"
    experiment = load(write_small_experiment(tmp_path, tables({name: {key: value}})))
    with pytest.raises(InputError, match=f"^effects: {name}: in real time .*; allowed"):
        Plant(experiment, step=H)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ([1e5, -1.0, 0.0, 0.0], "set pressure of front_right: given -1.0; allowed 0 or more"),
        ([1e5, 0.0, 0.0, np.nan], "set pressure of rear_right: given nan; allowed 0 or more"),
        ([1e5, 0.0], "set pressures: given 2 values; allowed 4, one for each chamber"),
    ],
)
def test_invalid_set_pressures_are_rejected(plant, asked, message):
    with pytest.raises(InputError, match=message):
        plant.advance(asked, H)


def test_invalid_names_and_values_of_faults_are_rejected(plant):
    with pytest.raises(InputError, match="did you mean leak_front_left"):
        plant.inject("leak_frontleft", 1.0)
    with pytest.raises(InputError, match="fault blocked_rear_left: given 1.5; allowed 0 to 1"):
        plant.inject("blocked_rear_left", 1.5)


def test_a_step_outside_its_range_is_rejected(plain):
    with pytest.raises(InputError, match="step of the plant: given 0.5; allowed"):
        Plant(plain[0], step=0.5)


@pytest.mark.slow
def test_held_samples_of_a_square_wave_fill_a_chamber_like_the_wave():
    """With edges within the time steps and at their starts."""
    wave, law = SquareWave(4.0, 1e5, 0.1), FirstOrderLag(0.087)
    given = H * jnp.arange(200.0)
    held = Held(given, jax.vmap(lambda t: wave.segment(t, t + 1e-6).a0)(given + 0.5 * H))
    for step in (H, 0.5 * H, 0.7 * H):
        times = jnp.arange(0.0, 0.99, step)
        expected = pressure_history(law, wave, 0.0, times)
        np.testing.assert_allclose(pressure_history(law, held, 0.0, times), expected, atol=1e-6)


@pytest.mark.parametrize("step", [1e-3, 2e-3, 2.5e-3])
def test_a_command_without_future_values_is_allowed_at_every_step_length(step):
    """Including steps for which rounding puts the next set pressure just before the step's end."""
    check_commands((RegulatorGain(0.1),), step, 104)
