"""Climbing: the pin holds, work goes where it may, mirrored is mirrored, and the command."""

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from slider_jax.beam.parameters import Numerics
from slider_jax.beam.state import straight_state
from slider_jax.cli.main import main
from slider_jax.climbing.climb import period_of, simulate_climb as climb_wall
from slider_jax.climbing.strides import ClimbPlan, climb_of, climb_on, join
from slider_jax.dynamics.pressures import start_chambers
from slider_jax.dynamics.step import at_rest, initial_carry
from slider_jax.effects.body.internal_friction import InternalFriction
from slider_jax.experiment.load import to_model
from slider_jax.io.csv import read_csv
from slider_jax.optimise.design_space import to_toml
from slider_jax.swimming.gait import Gait, to_climber
from slider_jax.swimming.paper_optimum import example_climber as built_in
from tests.support.helpers import dense_newton, nodes_of, stage_of

PLAN = ClimbPlan(settling=2, strides=4, numerics=Numerics(4, 12))
GAIT = Gait(2.0, 172.3e3, 150e3, 0.05, 0.07, 0.0058)
PIN = 0.88


def wall(gait=GAIT, pin=PIN, **options):
    return to_climber(to_model(built_in()), gait.frequency, pin, gait, **options)


@jax.jit
def climbed(model):
    f = model.support.frequency
    carry, before = climb_on(model, f, at_rest(model, PLAN.numerics), PLAN.settling, PLAN)
    carry, after = climb_on(model, f, carry, PLAN.strides, PLAN)
    series = join(before, after)
    return climb_of(model, f, series, PLAN), series, carry.ok


@pytest.fixture(scope="module")
def up():
    return climbed(wall())


@pytest.mark.slow
def test_it_climbs_on_pins_that_hold(up):
    found, series, ok = up
    print(f"U {1e3 * found.speed:.1f} mm/s, slip {found.slip:.1e} m/s")
    assert ok and found.speed > 0.01
    assert found.slip < 1e-8
    half = PLAN.steps_per_stride // 2
    for pins in np.asarray(series.pin)[1:].reshape(2 * PLAN.strides, half, 2):
        assert np.ptp(pins, axis=0).max() < 1e-8
    np.testing.assert_allclose(found.rises.sum(), np.ptp(series.midline[[0, -1], 0, -1]), rtol=1e-9)
    assert found.rises.mean() * GAIT.frequency == pytest.approx(float(found.speed), rel=0.05)


@pytest.mark.slow
def test_the_work_goes_into_height_and_losses(up):
    found, series, _ = up
    h = 1.0 / (GAIT.frequency * PLAN.steps_per_stride)
    work, lost = (h * np.sum(np.asarray(x)[1:]) for x in (series.power, series.dissipated))
    lifted = 0.7 * 0.368 * 9.81 * float(series.centre[-1, 0] - series.centre[0, 0])
    gained = float(series.stored[-1] - series.stored[0])
    print(f"work {work:.4f} J: lifted {lifted:.4f}, lost {lost:.4f}, gained {gained:.4f}")
    assert lifted > 0.3 * work and lost > 0.05 * work
    assert abs(work - lifted - lost - gained) < 0.01 * work
    assert found.efficiency == pytest.approx(lifted / (work - gained))
    assert found.unaccounted == pytest.approx(1.0 - (lifted + lost + gained) / work, abs=1e-9)


@pytest.mark.slow
def test_an_effect_in_the_body_takes_its_share():
    """Friction of the plies, a bending moment, is among what is dissipated."""
    model = wall()
    rubbing = replace(model, effects=(*model.effects, InternalFriction(jnp.asarray(4e-3))))
    (free, _, _), (found, _, ok) = climbed(model), climbed(rubbing)
    assert ok and found.dissipated > free.dissipated + 0.02
    assert abs(found.unaccounted) < 0.01


@pytest.mark.slow
def test_other_waves_climb_too():
    """A trapezoid is nearly a square wave; both are capped."""
    found = {}
    for waveform in ("square", "trapezoid"):
        strong = built_in().with_values({"trials.0.waveform": waveform, "trials.0.rise": 0.01})
        found[waveform], _, ok = climbed(to_climber(to_model(strong), jnp.asarray(2.0), PIN))
        assert ok
    speeds = [float(x.speed) for x in found.values()]
    assert speeds[0] == pytest.approx(speeds[1], rel=0.1) and speeds[0] > 0.01


@pytest.mark.slow
def test_mirrored_pins_and_pressures_climb_the_mirrored_path(up):
    mirrored = GAIT._replace(front=-GAIT.front, rear=-GAIT.rear)
    _, series, _ = climbed(wall(mirrored, link=-0.03))
    turned = np.asarray(series.midline) * np.array([1.0, -1.0])[:, None]
    np.testing.assert_allclose(turned, up[1].midline, atol=1e-8)
    assert np.ptp(up[1].midline[:, 1, 0]) > 0.02


@pytest.mark.slow
def test_without_pressure_it_hangs_still():
    model = wall(GAIT._replace(front=0.0, rear=0.0))
    y, memory = straight_state(nodes_of(model, PLAN.numerics))
    y, error = dense_newton(stage_of(model, PLAN.numerics, y, 1e9), y)
    strain = (y[0, 1:] + y[0, :-1]) / 2.0 / 1e5
    memory = replace(memory, motion=y[3:], strain=strain)
    f = jnp.asarray(2.0)
    carry, series = climb_on(model, f, initial_carry(y, memory, start_chambers(model)), 4, PLAN)
    assert carry.ok and error < 1e-8
    assert np.ptp(series.midline, axis=0).max() < 1e-8
    assert np.ptp(series.pin, axis=0).max() < 1e-12


def test_on_alternating_pins_alone_it_does_not_climb():
    """Chambers too weak to matter: each new pin is the lower one."""
    found, _, ok = climbed(wall(GAIT._replace(front=1.0, rear=1.0)))
    print(f"U {1e3 * found.speed:.2f} mm/s")
    assert ok and found.speed < -1e-3


def test_pressures_are_capped():
    strong, capped = wall(GAIT._replace(front=448e3, rear=-448e3)), wall()
    assert float(strong.drive.waves[0].amplitude) == 172.3e3
    assert float(strong.drive.waves[1].amplitude) == -172.3e3
    assert float(capped.drive.waves[1].amplitude) == 150e3
    assert [e.name() for e in strong.effects] == ["gravity"]


@pytest.mark.parametrize(
    ("rises", "period"),
    [
        ([1.0] * 15, 1),
        ([1.0, 3.0] * 8, 2),
        ([1.0, 2.0, 4.0] * 5, 3),
        (list(range(15)), 0),
        (np.linspace(10.0, 10.8, 15), 0),
        (np.linspace(0.1, 0.3, 15), 0),
    ],
)
def test_after_how_many_strides_a_climb_repeats(rises, period):
    assert period_of(1e-3 * np.array(rises), 0.03) == period


def coarse(**changes):
    values = {"numerics.nodes": 17, "numerics.step": 0.004} | changes
    return built_in().with_values(values)


def wall_of(run):
    return to_climber(to_model(coarse()), run.frequency, run.pin_phase)


@pytest.fixture(scope="module")
def ordered(tmp_path_factory):
    folder = tmp_path_factory.mktemp("climb")
    (folder / "wall.toml").write_text(to_toml(coarse(**{"trials.0.amplitude": 200e3})))
    assert main(["climb", str(folder / "wall.toml"), "--out", str(folder / "out")]) == 0
    return folder / "out"


@pytest.mark.slow
def test_without_pressure_the_command_says_that_it_hangs(tmp_path, capsys):
    (tmp_path / "wall.toml").write_text(to_toml(coarse(**{"trials.0.amplitude": 0.0})))
    assert main(["climb", str(tmp_path / "wall.toml"), "--out", str(tmp_path / "out")]) == 0
    assert (
        "the set pressures are 0: the left end stays pinned and the robot hangs"
        in capsys.readouterr().out
    )
    (row,) = json.loads((tmp_path / "out" / "climb.json").read_text())["climbs"]
    assert abs(row["speed_m_per_s"]) < 1e-4 and row["power_W"] == 0.0
    assert row["efficiency"] is None and row["dissipated_of_power"] is None
    assert row["speed_by_pin_phase_m_per_s"] is None


@pytest.mark.slow
def test_a_climb_counts_whole_periods():
    """Whatever stride it is looked at from: one that repeats after two gains no energy in them."""
    run = climb_wall(coarse(), pin_phase=0.875)
    assert run.period == 2 and len(run.found.rises) == 14
    assert abs(run.found.stored) < 2e-3
    steps = run.plan.steps_per_stride
    earlier = jax.tree.map(lambda x: x[: -2 * steps], run.series)
    before = climb_of(wall_of(run), jnp.asarray(2.0), earlier, run.plan)
    assert float(before.speed) == pytest.approx(float(run.found.speed), rel=0.01)


@pytest.mark.slow
def test_the_command_writes_what_it_found(ordered):
    told = json.loads((ordered / "climb.json").read_text())
    (row,) = told["climbs"]
    assert row["speed_m_per_s"] > 0.01 and row["cap_Pa"] == 172.3e3
    tried = row["speed_by_pin_phase_m_per_s"]
    assert len(tried) == 16 and max(tried, key=tried.get) == f"{row['pin_phase']:g}"
    weight = 0.7 * 0.368 * 9.81
    repeated = row["power_W"] * (1.0 - row["stored_of_power"])
    assert row["efficiency"] == pytest.approx(weight * row["speed_m_per_s"] / repeated)
    assert abs(row["unaccounted_of_power"]) < 0.01
    assert told["versions"]["jax"] and told["experiment"]["numerics"]["nodes"] == 17
    columns = read_csv(ordered / "climb_climb.csv", ("t_s", "centre_x_m", "power_W"))
    risen = columns["centre_x_m"][-1] / columns["t_s"][-1]
    assert risen == pytest.approx(row["speed_m_per_s"], rel=1e-6)
    assert (ordered / "climb_climb.png").stat().st_size > 10_000
    with Image.open(ordered / "climb_climb.gif") as film:
        assert film.n_frames == 96
        first = np.asarray(film.convert("L"))
        film.seek(48)
        assert np.mean(first != np.asarray(film.convert("L"))) > 0.01


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--cap", "172.3"], "--cap: given 172.3; allowed 1e3 to 2e6 Pa; pascal, not kPa or psi"),
        (["--pin-phase", "7"], "--pin-phase: given 7; allowed -1 to 1, a fraction of a period"),
        (["--link", "30"], "--link: given 30; allowed 0.005 to 0.2 m"),
        (["--trial", "3"], "--trial: given 3; allowed 0 to 0"),
        (
            ["--model", "m.toml"],
            "--model: this file changes an experiment; give EXPERIMENT.toml too",
        ),
    ],
)
def test_bad_options_are_told(words, said, tmp_path, capsys):
    assert main(["climb", "--out", str(tmp_path / "out"), *words]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_tip_mass_is_refused(tmp_path, capsys):
    text = to_toml(coarse()) + '\n[[effects]]\nname = "tip_mass"\nmass = 0.001\n'
    (tmp_path / "wall.toml").write_text(text)
    assert main(["climb", str(tmp_path / "wall.toml"), "--out", str(tmp_path / "out")]) == 2
    assert "tip_mass, which has inertia but no weight in this model" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
