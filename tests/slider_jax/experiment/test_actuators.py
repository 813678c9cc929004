"""Tests of [[actuators]]: any number of chambers, their sides, limits and drives, and bad input."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.beam.parameters import Numerics
from slider_jax.dynamics.pressures import start_chambers
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.dynamics.statics import Loads
from slider_jax.dynamics.time_schemes import SDIRK2
from slider_jax.errors import InputError
from slider_jax.experiment import drive
from slider_jax.experiment.load import load, to_model, to_numerics
from slider_jax.experiment.playback import read_played
from slider_jax.io.csv import read_csv
from slider_jax.io.files import write_csv
from slider_jax.observables import thrust
from slider_jax.simulation.trial import simulate_trial
from slider_jax.swimming.gait import to_climber
from tests.support.chambers import chamber_history
from tests.support.experiments import channel, refusal_of, write_small_experiment
from tests.support.helpers import arrays, static_state

SPANS = "front_chamber = [0.02, 0.145]\nrear_chamber = [0.155, 0.28]\n"


def chamber(name, near, far, more=""):
    return f'[[actuators]]\nkind = "pneumatic"\nname = "{name}"\nspan = [{near}, {far}]\n{more}\n'


FRONT, REAR = chamber("front", 0.02, 0.145), chamber("rear", 0.155, 0.28)


def with_actuators(folder, actuators, *changes):
    """Writes the small experiment with `actuators` instead of the front and the rear chamber."""
    tables = ("[[trials]]", f"{actuators}[[trials]]")
    return write_small_experiment(folder, (SPANS, ""), tables, *changes)


def series_of(path, trial=0):
    return simulate_trial(load(path), trial).series


def evenly(count):
    """Returns `count` chambers of equal length between 0.02 and 0.28 m."""
    ends = np.linspace(0.02, 0.28, count + 1)
    return "".join(chamber(f"c{i}", ends[i], ends[i + 1]) for i in range(count))


@pytest.mark.slow
def test_two_actuators_are_the_front_and_the_rear_chamber(tmp_path):
    old = series_of(write_small_experiment(tmp_path))
    new = series_of(with_actuators(tmp_path, FRONT + REAR))
    assert list(new) == list(old)
    for name, values in old.items():
        np.testing.assert_array_equal(new[name], values, err_msg=name)


@pytest.mark.slow
def test_two_halves_of_a_chamber_are_the_whole_chamber(tmp_path):
    whole = series_of(with_actuators(tmp_path, chamber("whole", 0.02, 0.28)))
    halves = chamber("first", 0.02, 0.137) + chamber("second", 0.137, 0.28)
    drive = ("rear_ratio = 0.9\nphase = 0.1\n", "phases = [0.0, 0.0]\n")
    both = series_of(with_actuators(tmp_path, halves, drive))
    for name in ("thrust", "recoil", "tip"):
        size = np.abs(whole[name]).max()
        np.testing.assert_allclose(both[name], whole[name], rtol=0.0, atol=1e-8 * size)


def test_a_single_chamber_ignores_the_phase_of_the_last_chamber(tmp_path):
    path = with_actuators(tmp_path, chamber("only", 0.02, 0.28))
    (wave,) = to_model(load(path)).drive.waves
    assert wave.amplitude == 150e3 and wave.phase == 0.0


def test_the_chambers_between_follow_linearly(tmp_path):
    waves = to_model(load(with_actuators(tmp_path, evenly(3)))).drive.waves
    np.testing.assert_allclose([x.amplitude for x in waves], [150e3, 142.5e3, 135e3])
    np.testing.assert_allclose([x.phase for x in waves], [0.0, 0.05, 0.1])
    own = ("rear_ratio = 0.9\nphase = 0.1\n", "ratios = [1.0, 0.5, -1.0]\nphases = [0, 0.3, 0.1]\n")
    waves = to_model(load(with_actuators(tmp_path, evenly(3), own))).drive.waves
    np.testing.assert_allclose([x.amplitude for x in waves], [150e3, 75e3, -150e3])
    np.testing.assert_allclose([x.phase for x in waves], [0.0, 0.3, 0.1])


@pytest.mark.slow
def test_each_chamber_has_its_own_moment_per_pressure(tmp_path):
    """Twice the ratio and half the pressure give the same motion."""
    double = chamber("rear", 0.155, 0.28, "K_Q_ratio = 2.0")
    half = ("rear_ratio = 0.9", "rear_ratio = 0.45")
    found = series_of(with_actuators(tmp_path, FRONT + double, half))
    old = series_of(write_small_experiment(tmp_path))
    np.testing.assert_allclose(found["p_rear"], 0.5 * old["p_rear"], rtol=1e-12)
    np.testing.assert_allclose(found["tip"], old["tip"], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("effect", ["", '[[effects]]\nname = "leakage"\n'])
def test_each_chamber_has_its_own_time_constant(tmp_path, effect):
    """The first rise to A after the start is A (1 - exp(-t/(r k))); an effect at its null, too."""
    slow = chamber("rear", 0.155, 0.28, "k_ratio = 1.7")
    together = ("rear_ratio = 0.9\nphase = 0.1\n", "")
    path = with_actuators(tmp_path, FRONT + slow + effect, together)
    assert (law := to_model(load(path)).pressure_law).k == 0.087
    np.testing.assert_allclose(law.time_constants, [0.087, 1.7 * 0.087])
    model, t = arrays(to_model(load(path))), np.arange(0.0, 0.125, 5e-3)
    pressures = chamber_history(model, start_chambers(model), jnp.asarray(t)).p
    for found, ratio in zip(pressures.T, (1.0, 1.7), strict=True):
        exact = 150e3 * (1.0 - np.exp(-t / (ratio * 0.087)))
        np.testing.assert_allclose(found, exact[1:], atol=1e-6 * 150e3)


def test_ratios_of_1_do_not_change_the_program(tmp_path):
    plain, null = (
        to_model(load(with_actuators(tmp_path, chamber("only", 0.02, 0.28, keys))))
        for keys in ("", "k_ratio = 1.0\nK_Q_ratio = 1.0")
    )
    assert jax.tree.structure(plain) == jax.tree.structure(null)


@pytest.mark.slow
def test_a_left_and_a_right_chamber_are_a_pair(tmp_path):
    """Both take their half of the same wave, so their signed pressures add up to the pair's.

    Without a lag this is exact. With the lag, both chambers vent while the other one fills.
    """
    sides = chamber("left", 0.02, 0.28, 'side = "left"') + chamber(
        "right", 0.02, 0.28, 'side = "right"'
    )
    together = ("rear_ratio = 0.9\nphase = 0.1\n", "phases = [0.0, 0.0]\n")
    apart = series_of(with_actuators(tmp_path, sides, together))
    pair = series_of(with_actuators(tmp_path, chamber("pair", 0.02, 0.28)))
    assert apart["p_left"].min() >= 0.0 and apart["p_right"].max() <= 0.0
    np.testing.assert_allclose(apart["p_left"] + apart["p_right"], pair["p_pair"], atol=1e-6)
    np.testing.assert_allclose(apart["tip"], pair["tip"], rtol=1e-9, atol=1e-12)


@pytest.mark.slow
def test_co_contraction_stiffens_the_body_without_bending_it(tmp_path):
    """Two chambers of c |p| each, over the body: EI' = EI + c (p_left + p_right).

    Their difference bends the body to an arc of the curvature K_Q (p_left - p_right)/EI', behind
    which the tail is straight. A small force F on the tail's end deflects it by
    F ((L^3 - t^3)/(3 EI') + t^3/(3 EI_t)), with the length t of the tail.
    """
    c, base, difference, force = 1e-7, 150e3, 10e3, 1e-4
    keys = f"stiffening = {c}\nside = "
    sides = "".join(chamber(x, 0.0, 0.3, f'{keys}"{x}"') for x in ("left", "right"))
    model = to_model(load(with_actuators(tmp_path, sides)))
    robot, t, body = model.robot, 0.07, 0.3
    assert (float(robot.body.length), float(robot.tail.length)) == (body, t)
    EI = float(robot.body.EI) + 2.0 * c * base
    numerics = Numerics(tail_cells=10, body_cells=40)
    pressures = np.array([base + 0.5 * difference, 0.5 * difference - base])
    bent = static_state(model, Loads(jnp.zeros(2), jnp.asarray(pressures)), numerics)
    turn = float(robot.K_Q) * difference * body / EI
    y = body * (1.0 - math.cos(turn)) / turn + t * math.sin(turn)
    np.testing.assert_allclose(bent.shape[1, 0], y, rtol=1e-3)
    still = Loads(jnp.asarray([0.0, force]), jnp.asarray([base, -base]))
    loaded = static_state(model, still, numerics)
    L = t + body
    y = force * ((L**3 - t**3) / EI + t**3 / float(robot.tail.EI)) / 3.0
    np.testing.assert_allclose(loaded.shape[1, 0], y, rtol=1e-3)


def test_chambers_without_stiffening_have_the_same_program(tmp_path):
    """The key changes the program, and its null value does not."""
    plain, null, stiff = (
        to_model(load(with_actuators(tmp_path, chamber("only", 0.02, 0.28, keys))))
        for keys in ("", "stiffening = 0.0", "stiffening = 1e-7")
    )
    assert jax.tree.structure(plain) == jax.tree.structure(null) != jax.tree.structure(stiff)


@pytest.mark.slow
def test_stiffening_reduces_the_motion_and_not_the_pressure(tmp_path):
    series = series_of(with_actuators(tmp_path, chamber("only", 0.02, 0.28, "stiffening = 1e-7")))
    free = series_of(with_actuators(tmp_path, chamber("only", 0.02, 0.28)))
    np.testing.assert_array_equal(series["p_only"], free["p_only"])
    assert np.ptp(series["tip"]) < 0.9 * np.ptp(free["tip"])


def test_a_limit_and_a_bias_change_the_set_pressure(tmp_path):
    limited = chamber("front", 0.02, 0.145, "limit = 60e3") + REAR
    biased = ("phase = 0.1\n", "phase = 0.1\nbiases = [0.0, 20e3]\n")
    path = with_actuators(tmp_path, limited, biased)
    front, rear = to_model(load(path)).drive.waves
    for t, sign in ((0.05, 1.0), (0.2, -1.0)):
        at = front.segment(np.asarray(t), np.asarray(t + 0.001))
        assert float(at.b1) == sign * 60e3
        at = rear.segment(np.asarray(t), np.asarray(t + 0.001))
        np.testing.assert_allclose(float(at.b1), sign * 135e3 + 20e3)


@pytest.mark.slow
def test_a_robot_without_chambers_is_passive(tmp_path):
    """The tail of a towed foil that heaves moves; a robot at rest stays at rest."""
    still = ("amplitude = 150000.0", "amplitude = 0.0"), ("amplitude = 250000.0", "amplitude = 0.0")
    rest = series_of(write_small_experiment(tmp_path, (SPANS, ""), *still))
    assert list(rest) == ["thrust", "recoil", "tip"]
    np.testing.assert_array_equal(rest["tip"], 0.0)
    heave = ("tow_speed = 0.0", "tow_speed = 0.2\nheave = 0.01")
    assert (
        np.ptp(series_of(write_small_experiment(tmp_path, (SPANS, ""), *still, heave))["tip"]) > 0
    )


@pytest.mark.slow
def test_the_size_of_the_program_does_not_depend_on_the_number_of_chambers(tmp_path):
    sizes = []
    for count in (1, 2, 3, 6):
        path = with_actuators(tmp_path, evenly(count), ("nodes = 11", "nodes = 51"))
        experiment = load(path)
        model, (numerics, _) = to_model(experiment), to_numerics(experiment)

        def run(model, numerics=numerics):
            times = TimeGrid(5e-3, 20)
            return rollout(model, times, thrust, numerics, SDIRK2, checkpoint=False).saved

        compiled = jax.jit(run).lower(model).compile()
        sizes.append((len(compiled.as_text()), compiled.cost_analysis()["flops"]))
    for size in np.transpose(sizes):
        assert max(size) < 1.3 * min(size), sizes


CASES = {
    "unknown kind": (
        FRONT.replace("pneumatic", "hydraulic"), "actuators.0.kind: given 'hydraulic'; allowed",
    ),
    "no kind": (
        FRONT.replace('kind = "pneumatic"\n', ""),
        "actuators.0.kind: given nothing; allowed pneumatic",
    ),
    "no span": (FRONT.replace("span = [0.02, 0.145]\n", ""), "actuators.0.span: missing"),
    "no name": (FRONT.replace('name = "front"\n', ""), "actuators.0.name: missing"),
    "unknown key": (
        FRONT.replace("span", "K_Q = 1e-7\nspan"),
        "actuators.0.K_Q: unknown key; allowed kind, name",
    ),
    "name with a space": (
        chamber("my chamber", 0.02, 0.1),
        "actuators.0.name: given 'my chamber'; allowed lower-case",
    ),
    "same name": (
        FRONT + chamber("front", 0.155, 0.28),
        "actuators.1.name: given 'front'; allowed a name that no other actuator has",
    ),
    "name of a chamber": (
        FRONT + chamber("front_left", 0.155, 0.28, 'side = "left"'),
        "actuators.1.name: given 'front_left'; allowed another name, because the chambers front_",
    ),
    "overlap": (
        FRONT + chamber("rear", 0.1, 0.28),
        "actuators.1.span: given [0.1, 0.28]; allowed a span outside of [0.02, 0.145] m, the span "
        "of front",
    ),
    "a pair over a single chamber": (
        chamber("left", 0.02, 0.145, 'side = "left"') + chamber("rear", 0.1, 0.28),
        "actuators.1.span: given [0.1, 0.28]; allowed a span outside of [0.02, 0.145]",
    ),
    "wrong order": (
        REAR + FRONT,
        "actuators.1.span: given [0.02, 0.145]; allowed a near end of at least 0.155 m",
    ),
    "reversed": (
        chamber("front", 0.145, 0.02), "actuators.0.span: given [0.145, 0.02]; allowed [near, far]",
    ),
    "beyond the body": (
        chamber("front", 0.02, 0.31), "actuators.0.span: given [0.02, 0.31]; allowed spans within",
    ),
    "millimetres": (
        chamber("front", 20.0, 145.0),
        "actuators.0.span.0: given 20.0; allowed 0 to 3 m",
    ),
    "limit in kPa": (
        chamber("front", 0.02, 0.145, "limit = 200"),
        "actuators.0.limit: given 200.0; allowed 1000 to 2e+06 Pa",
    ),
    "unknown side": (
        chamber("front", 0.02, 0.145, 'side = "top"'),
        "actuators.0.side: given 'top'; allowed 'both', 'left' or 'right'",
    ),
    "ratio of zero": (
        chamber("front", 0.02, 0.145, "K_Q_ratio = 0"),
        "actuators.0.K_Q_ratio: given 0.0; allowed 0.01",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_wrong_actuators_are_one_clear_error(case, tmp_path):
    actuators, message = CASES[case]
    assert message in refusal_of(with_actuators(tmp_path, actuators))


def tendon(name, keys, offset="0.01"):
    place = f"span = [0.05, 0.3]\noffset = {offset}\n"
    return f'[[actuators]]\nkind = "tendon"\nname = "{name}"\n{place}{keys}\n'


def shape(keys, span="[0.05, 0.25]"):
    return f'[[actuators]]\nkind = "shape"\nname = "wave"\nspan = {span}\n{keys}\n'


def moment(keys):
    return f'[[actuators]]\nkind = "moment"\nname = "muscle"\nspan = [0.0, 0.3]\n{keys}\n'


WAVE = "wavelength = 0.4\namplitude = [2.0, 0.0, 0.0]"
OTHERS = {
    "tendon without drive": (
        tendon("t", ""), "actuators.0.tension: given nothing; allowed either tension or pull",
    ),
    "tendon with two drives": (
        tendon("t", "tension = 1.0\npull = 0.01\nstiffness = 2e4"),
        "actuators.0.tension: given tension and pull; allowed either tension or pull",
    ),
    "pull without stiffness": (
        tendon("t", "pull = 0.01"),
        "actuators.0.stiffness: given nothing; allowed a stiffness in N/m",
    ),
    "a tension that pushes": (
        tendon("t", "tension = 1.0\npushes = true"),
        "actuators.0.pushes: given true; allowed true only",
    ),
    "offset in millimetres": (
        tendon("t", "tension = 1.0", "10.0"),
        "actuators.0.offset.0: given 10.0; allowed -0.5 to 0.5 m",
    ),
    "three offsets": (tendon("t", "tension = 1.0", "[0.01, 0.01, 0.0]"), "actuators.0.offset"),
    "key of another kind": (
        tendon("t", "tension = 1.0\nlimit = 1e5"),
        "actuators.0.limit: unknown key; allowed kind, name, span, offset",
    ),
    "tendon beyond the robot": (
        tendon("t", "tension = 1.0").replace("0.3]", "0.4]"),
        "actuators.0.span: given [0.05, 0.4]; allowed spans within the robot, 0 to 0.37 m",
    ),
    "shape without source": (
        shape(""),
        "actuators.0.wavelength: given nothing; allowed a value without",
    ),
    "shape with two sources": (
        shape(f'{WAVE}\nfile = "a.csv"'),
        "actuators.0.wavelength: given 0.4; allowed a value without",
    ),
    "zero wavelength": (
        shape(WAVE.replace("0.4", "0.0")),
        "actuators.0.wavelength: given 0.0; allowed a length other",
    ),
    "two amplitudes": (shape(WAVE.replace(", 0.0]", "]")), "actuators.0.amplitude"),
    "shape over a tendon": (
        tendon("t", "tension = 1.0") + shape(WAVE),
        "actuators.1.span: given [0.05, 0.25]; allowed a span outside of [0.05, 0.3]",
    ),
    "moment without table": (moment(""), "actuators.0.table: missing"),
    "table in another folder": (
        moment('table = "../a.csv"'),
        "actuators.0.table: given '../a.csv'; allowed a plain file name",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", OTHERS)
def test_wrong_tendons_moments_and_shapes_are_one_clear_error(case, tmp_path):
    actuators, message = OTHERS[case]
    assert message in refusal_of(with_actuators(tmp_path, actuators, *IDLE))


IDLE = ("amplitude = 150000.0\n", ""), ("amplitude = 250000.0\n", "")
"""Changes of a robot without chambers: the trials have no pressure."""


@pytest.mark.slow
def test_a_robot_with_a_pair_of_tendons_swings(tmp_path):
    """Two tendons in antiphase pull in turn, and the body bends to both sides alike."""
    both = tendon("left", "tension = 1.0\nbias = 1.0") + tendon(
        "right", "tension = 1.0\nbias = 1.0\nphase = 0.5", "-0.01"
    )
    sine = ("frequency = 4.0", 'waveform = "sine"\neffort = 2.0\nfrequency = 4.0')
    experiment = load(with_actuators(tmp_path, both, *IDLE, sine))
    left, right = to_model(experiment).actuators
    t = np.asarray(0.0625)  # a quarter of a period
    assert float(left.tension(0.0, t)) == pytest.approx(3.0)
    assert float(right.tension(0.0, t)) == 0.0  # a negative tension is none
    tip = simulate_trial(experiment).series["tip"]
    assert tip.max() > 1e-3 and tip.min() < -1e-3


def test_an_elastic_tendon_has_its_length_and_stiffness(tmp_path):
    keys = "pull = 0.002\nstiffness = 2e4\npushes = true"
    path = with_actuators(tmp_path, tendon("t", keys, "[0.01, 0.0]"), *IDLE)
    (found,) = to_model(load(path)).actuators
    assert float(found.tension(0.001, np.asarray(0.05))) == pytest.approx(2e4 * 0.003)
    np.testing.assert_allclose(found.offset_at(np.array([0.05, 0.175, 0.3])), [0.01, 0.005, 0.0])


@pytest.mark.slow
def test_a_prescribed_wave_bends_the_body(tmp_path):
    table = channel("curvature", ["k"], name="k", s=0.15)
    bend = ("[numerics]", f"{table}[numerics]")
    changes = *IDLE, bend, ("nodes = 11", "nodes = 51")
    path = with_actuators(tmp_path, shape(WAVE, "[0.0, 0.3]"), *changes)
    run = simulate_trial(load(path))
    expected = 2.0 * np.sin(2.0 * np.pi * (4.0 * run.t - 0.15 / 0.4))
    np.testing.assert_allclose(run.series["k"][1:], expected[1:], atol=0.02)


def test_a_shape_and_a_moment_from_files(tmp_path):
    t, s = np.meshgrid(np.linspace(0.0, 1.0, 11), [0.0, 0.3], indexing="ij")
    rows = np.stack([t.ravel(), s.ravel(), (t * s).ravel()], axis=1)
    np.savetxt(
        tmp_path / "shape.csv", rows, delimiter=",", header="t_s,s_m,curvature_per_m", comments=""
    )
    (found,) = to_model(
        load(with_actuators(tmp_path, shape('file = "shape.csv"'), *IDLE))
    ).actuators
    assert load(tmp_path / "experiment.toml").files == ["shape.csv"]
    curvature = found.curvature(np.array([0.1, 0.2]), np.asarray(0.55))
    np.testing.assert_allclose(curvature, [0.055, 0.11], rtol=1e-6)
    lines = (tmp_path / "shape.csv").read_text().splitlines()
    (tmp_path / "shape.csv").write_text("\n".join(lines[:-1]))
    with pytest.raises(
        InputError, match=r"shape\.csv: given 21 rows with 11 x 2 values, without t_s"
    ):
        to_model(load(tmp_path / "experiment.toml"))

    rows = np.stack([t.ravel(), (s / 0.3).ravel(), (t - 0.1 * s).ravel()], axis=1)
    header = "command,curvature_per_m,moment_N_m"
    np.savetxt(tmp_path / "muscle.csv", rows, delimiter=",", header=header, comments="")
    muscle = moment('table = "muscle.csv"\namplitude = 0.5\nbias = 0.2')
    path = with_actuators(tmp_path, muscle, *IDLE)
    (found,) = to_model(load(path)).actuators
    assert load(path).files == ["muscle.csv"]
    assert float(found.command.at(np.asarray(0.05))) == pytest.approx(0.7)
    np.testing.assert_allclose(found.moments[7], [0.7, 0.67], rtol=1e-6)


DRIVES = {
    "too few ratios": (
        "ratios = [1.0]\n",
        "trials.0.ratios: given [1.0]; allowed one number for each",
    ),
    "ratios and rear_ratio": (
        "rear_ratio = 0.9\nratios = [1.0, 0.9]\n",
        "trials.0.rear_ratio: given 0.9; allowed nothing, because the trial has ratios",
    ),
    "phases and phase": (
        "phase = 0.1\nphases = [0.0, 0.1]\n", "trials.0.phase: given 0.1; allowed nothing",
    ),
    "phase in degrees": (
        "phases = [0.0, 36.0]\n",
        "trials.0.phases.1: given 36.0; allowed -1 to 1",
    ),
    "bias without chamber": (
        "biases = [1e3, 1e3, 1e3]\n",
        "trials.0.biases: given [1000.0, 1000.0, 1000.0]; allowed one",
    ),
    "NaN": ("ratios = [nan, 1.0]\n", "trials.0.ratios.0: given nan; allowed -20 to 20"),
    "speed of a clamped robot": (
        "start_speed = 0.2\n",
        'trials.0.start_speed: given 0.2; allowed 0, unless support is "free"',
    ),
    "towed free robot": (
        'support = "free"\nheave = 0.01\n',
        'trials.0.heave: given 0.01; allowed 0, unless support is "clamped"',
    ),
    "unknown support": (
        'support = "pinned"\n',
        "trials.0.support: given 'pinned'; allowed 'clamped'",
    ),
    "half a lead stride": ("lead_strides = 0.5\n", "trials.0.lead_strides: given 0.5"),
    "lead with another clamp frequency": (
        "lead_strides = 2\nheave = 0.01\nclamp_frequency = 1.0\n",
        "trials.0.lead_strides: given 2; allowed 0 for a recorded drive",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", DRIVES)
def test_wrong_drives_are_one_clear_error(case, tmp_path):
    keys, message = DRIVES[case]
    old = "rear_ratio = 0.9\nphase = 0.1\n"
    assert message in refusal_of(write_small_experiment(tmp_path, (old, keys)))


def test_chambers_are_described_only_once(tmp_path):
    with pytest.raises(
        InputError, match=r"robot\.front_chamber: given \[0\.02, 0\.145\]; allowed "
    ):
        load(write_small_experiment(tmp_path, ("[[trials]]", f"{FRONT}[[trials]]")))
    with pytest.raises(
        InputError, match=r"trials\.0\.amplitude: given 150000\.0; allowed 0, as the"
    ):
        load(write_small_experiment(tmp_path, (SPANS, "")))


def test_the_chambers_of_the_robot_are_checked_like_those_of_a_list(tmp_path):
    """Both chambers in [robot] take part in all checks of [[actuators]]."""
    cases = {
        "rear_chamber: given [0.1, 0.28]; allowed a span outside of [0.02, 0.145]": "[0.1, 0.28]",
        "rear_chamber: given [0.2, 0.2]; allowed [near, far] with near < far": "[0.2, 0.2]",
        "rear_chamber: given [0.0, 0.01]; allowed a near end of at least 0.02 m": "[0.0, 0.01]",
    }
    for message, span in cases.items():
        path = write_small_experiment(tmp_path, ("[0.155, 0.28]", span))
        assert f"robot.{message}" in refusal_of(path)
    path = write_small_experiment(tmp_path, ("[[trials]]", f"{shape(WAVE)}[[trials]]"))
    assert "actuators.0.span: given [0.05, 0.25]; allowed a span outside" in refusal_of(path)


def test_a_recorded_drive_is_read_once(tmp_path, monkeypatch):
    recorded = (
        "frequency = 4.0\namplitude = 150000.0\nrear_ratio = 0.9\nphase = 0.1\n",
        'waveform = "recorded"\ndrive_file = "drive.csv"\ndrive_is = "measured"\n',
    )
    still = ("amplitude = 250000.0", "amplitude = 0.0")
    tendons = tendon("a", "tension = 1.0") + tendon("b", "tension = 1.0")
    read: list[str] = []

    def counted(path, *args, **options):
        read.append(path.name)
        return read_csv(path, *args, **options)

    monkeypatch.setattr(drive, "read_csv", counted)
    t = np.linspace(0.0, 0.8, 81)
    table = np.stack([t, *(1e4 * np.sin(12.0 * t + i) for i in range(3))], axis=1)
    header = "t_s,a_N,b_N,p_only_Pa"
    np.savetxt(tmp_path / "drive.csv", table, delimiter=",", header=header, comments="")
    for chambers in ("", chamber("only", 0.02, 0.28)):
        model = to_model(load(with_actuators(tmp_path, chambers + tendons, recorded, still)))
        np.testing.assert_allclose(model.actuators[1].wave.values, table[:, 2])
        assert len(model.drive.waves) == bool(chambers)
    assert read == ["drive.csv"] * 2


def test_a_recorded_drive_has_a_column_for_each_chamber(tmp_path):
    recorded = (
        "frequency = 4.0\namplitude = 150000.0\nrear_ratio = 0.9\nphase = 0.1\n",
        'waveform = "recorded"\ndrive_file = "drive.csv"\n',
    )
    path = with_actuators(tmp_path, evenly(3), recorded)
    t = np.linspace(0.0, 0.8, 81)
    table = np.stack([t, *(5e4 * np.sin(12.0 * t + i) for i in range(3))], axis=1)
    header = "t_s,p_c0_Pa,p_c1_Pa,p_c2_Pa"
    np.savetxt(tmp_path / "drive.csv", table, delimiter=",", header=header, comments="")
    waves = to_model(load(path)).drive.waves
    np.testing.assert_allclose([x.values for x in waves], table[:, 1:].T)
    text = (tmp_path / "drive.csv").read_text().replace("p_c1_Pa", "p_rear_Pa")
    (tmp_path / "drive.csv").write_text(text)
    with pytest.raises(
        InputError, match="column p_c1_Pa is missing; given t_s, p_c0_Pa, p_rear_Pa"
    ):
        to_model(load(path))


def test_a_climber_keeps_the_limits_and_biases_of_its_chambers(tmp_path):
    """The cap of 100 kPa is lower than the amplitude and higher than the limit of c1."""
    limited = evenly(3).replace('name = "c1"', 'name = "c1"\nlimit = 60e3')
    biased = ("phase = 0.1\n", "phase = 0.1\nbiases = [0.0, 0.0, 20e3]\n")
    model = to_model(load(with_actuators(tmp_path, limited, biased)))
    climber = to_climber(model, 4.0, 0.0, cap=100e3)
    at = np.asarray(0.06), np.asarray(0.061)
    found = [float(x.segment(*at).a0) for x in climber.drive.waves]
    np.testing.assert_allclose(found, [100e3, 60e3, 100e3])
    assert float(climber.support.frequency) == 4.0
    still = ("amplitude = 150000.0", "amplitude = 0.0"), ("amplitude = 250000.0", "amplitude = 0.0")
    for actuators, frequency in (("", 0.0), (limited, 0.0), (tendon("t", "tension = 1.0"), 4.0)):
        model = to_model(load(with_actuators(tmp_path, actuators, *still)))
        assert float(to_climber(model, 4.0, 0.0).support.frequency) == frequency


def test_a_played_drive_has_the_amplitude_of_the_first_chamber(tmp_path):
    own = ("rear_ratio = 0.9\nphase = 0.1\n", "ratios = [-0.5, 1.0]\nbiases = [10e3, 0.0]\n")
    experiment = load(with_actuators(tmp_path, FRONT + REAR, own))
    columns = {"t_s": np.array([0.0, 0.4, 0.75]), "set_front_Pa": np.array([-65e3, 85e3, 85e3])}
    played = tmp_path / "trial_00.played.csv"
    write_csv(played, columns | {"set_rear_Pa": np.full(3, 150e3)})
    assert read_played(experiment, experiment.trials[0]) is not None
    columns["set_front_Pa"][1:] = 60e3
    write_csv(played, columns | {"set_rear_Pa": np.full(3, 150e3)})
    with pytest.raises(InputError, match="amplitude is 65000 Pa, but 85000 Pa in the trial"):
        read_played(experiment, experiment.trials[0])
