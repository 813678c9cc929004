"""EI, alpha and K_Q from bench tables: the beam equals closed forms, and fits recover known values.

The tables come from an elastica that the test integrates and from the closed form of a cantilever's
free decay, not from the fitted beam.
"""

import json
import math
import tomllib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from calibration.bench import statics
from calibration.bench.ring_down import fit_decay, fit_ring_down
from calibration.bench.statics import fit_shapes, identifiable_parameters
from calibration.bench.tables import Bench, RingDown, Shapes, StaticsTable, load_bench
from slider_jax.beam.parameters import Numerics, uniform_robot
from slider_jax.cli.main import main
from slider_jax.errors import InputError
from slider_jax.io.toml import read_toml, validate
from tests.support.data import ROOT
from tests.support.experiments import ROBOT_TABLE

ROBOT = {
    "body_length": 0.3, "tail_length": 0.07, "linear_density": 0.7, "EI_body": 0.038,
    "EI_tail": 0.0058, "damping_time": 0.002, "height": 0.03,
    "front_chamber": [0.02, 0.145], "rear_chamber": [0.155, 0.28],
}  # fmt: skip
TRUTH = {"EI_body": 0.042, "EI_tail": 0.005, "K_Q": 4.3e-7}
FORCES = np.linspace(0.03, 0.4, 8)
TAIL_FORCES = np.linspace(0.05, 0.8, 8)
PRESSURES = np.linspace(3e4, 3e5, 8)
NOISE = 5e-4
MESH = Numerics(tail_cells=6, body_cells=24)


def elastica(force, pressure=(0.0, 0.0), length=None, EI=None, spans=()):
    """Returns tip and joint (2,) [m] of a clamped inextensible rod, by shooting.

    M' = -F cos(theta), EI theta' = M + K_Q p, M(L) = 0: an elastica under a force of constant
    direction and the moment of its chambers; EI changes at the joint.
    """
    L = length or ROBOT["body_length"] + ROBOT["tail_length"]
    joint = L if EI else ROBOT["body_length"]

    def stiffness(s):
        return EI or (TRUTH["EI_body"] if s < joint else TRUTH["EI_tail"])

    def active(s):
        return TRUTH["K_Q"] * sum(
            p * (near <= s < far) for p, (near, far) in zip(pressure, spans, strict=False)
        )

    breaks = sorted({0.0, L, joint, *(x for span in spans for x in span)})

    def run(moment):
        y, at_joint = np.array([moment, 0.0, 0.0, 0.0]), 0.0
        for a, b in zip(breaks, breaks[1:], strict=False):
            middle = 0.5 * (a + b)
            EI_here, extra = stiffness(middle), active(middle)

            def slope(s, y, EI_here=EI_here, extra=extra):
                M, theta, _, _ = y
                return [-force * math.cos(theta), (M + extra) / EI_here,
                        math.cos(theta), math.sin(theta)]  # fmt: skip

            y = solve_ivp(slope, (a, b), y, rtol=1e-9, atol=1e-11).y[:, -1]
            if b == joint:
                at_joint = y[3]
        return y, at_joint

    root = brentq(lambda m: run(m)[0][0], -1.0, 1.0, xtol=1e-12) if force else 0.0
    y, at_joint = run(root)
    return np.array([y[3], at_joint])


def table_of():
    return StaticsTable(name="bench", robot=ROBOT)


def robot_of(**changes):
    return uniform_robot(**(ROBOT | changes))


@pytest.fixture(scope="module")
def exact():
    """Noise-free tips: robot under loads, tail alone under loads, robot under pressures."""
    spans = (ROBOT["front_chamber"], ROBOT["rear_chamber"])
    whole = [elastica(f)[0] for f in FORCES]
    tail = [elastica(f, length=0.07, EI=TRUTH["EI_tail"])[0] for f in TAIL_FORCES]
    bent = [elastica(0.0, (p, 0.9 * p), spans=spans)[0] for p in PRESSURES]
    return [np.array(x) for x in (whole, tail, bent)]


def bench_of(exact, rng, declared=NOISE, zero=2e-3):
    """Returns a bench of three tables with noise and a ruler's zero."""
    tips = [x + zero + NOISE * rng.normal(size=len(x)) for x in exact]
    still, none = np.zeros((8, 2)), np.zeros(8)
    both = np.stack([PRESSURES, 0.9 * PRESSURES], axis=1)
    shapes = (
        Shapes("whole.csv", "tip_load", False, FORCES, still, tips[0], None, declared),
        Shapes("tail.csv", "tip_load", True, TAIL_FORCES, still, tips[1], None, declared),
        Shapes("bent.csv", "pressure", False, none, both, tips[2], None, declared),
    )
    return Bench(table_of(), robot_of(), shapes, None)


def model_tips(robot, on_tail, force, pressure):
    """Returns tips (8,) of the beam and their slopes; 24 rows share the compiled program."""
    rows = tuple(
        jnp.asarray(np.concatenate([np.asarray(x)] * 3)) for x in (on_tail, force, pressure)
    )
    robot = jax.tree.map(lambda x: jnp.asarray(x, float), robot)
    logs = jnp.log(jnp.asarray([float(robot.body.EI), float(robot.tail.EI), float(robot.K_Q)]))
    value, slope = statics._shapes(logs, robot, rows, MESH)
    return np.asarray(value)[0, :8], np.asarray(slope)[0, :8]


@pytest.mark.slow
def test_the_tip_equals_that_of_elastica_and_arcs():
    """The elastica at P L^2/EI = 1, a weak load's P L^3/(3 EI), and two chambers' exact arcs."""
    L, EI = 0.37, 0.038
    loads = np.r_[EI / L**2, 1e-3 * EI / L**2, np.zeros(6)]
    still = np.zeros((8, 2))
    tips, slopes = model_tips(robot_of(EI_tail=EI), np.zeros(8, bool), loads, still)
    assert tips[0] / L == pytest.approx(0.30172, rel=1e-3)
    assert tips[1] / L == pytest.approx(1e-3 / 3.0, rel=1e-3)
    assert slopes[1, :2].sum() == pytest.approx(-tips[1], rel=1e-3)  # the tip is linear in 1/EI

    spans = (ROBOT["front_chamber"], ROBOT["rear_chamber"])
    both = np.stack([PRESSURES, 0.9 * PRESSURES], axis=1)
    robot = robot_of(EI_body=TRUTH["EI_body"], EI_tail=TRUTH["EI_tail"], K_Q=TRUTH["K_Q"])
    tips, _ = model_tips(robot, np.zeros(8, bool), np.zeros(8), both)
    for p, tip in zip(PRESSURES, tips, strict=True):
        angle, y = 0.0, 0.0
        for length, q in ((0.02, 0.0), (0.125, p), (0.01, 0.0), (0.125, 0.9 * p), (0.09, 0.0)):
            turn = TRUTH["K_Q"] * q * length / TRUTH["EI_body"]
            y += length * math.sin(angle + 0.5 * turn) * np.sinc(0.5 * turn / math.pi)
            angle += turn
        assert tip == pytest.approx(y, rel=3e-3)
        assert elastica(0.0, (p, 0.9 * p), spans=spans)[0] == pytest.approx(y, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("declared", [NOISE, None])
def test_intervals_hold_the_truth(exact, declared):
    """15 benches of 3 parameters, from an elastica with noise and a shifted ruler."""
    held = 0
    for seed in range(15):
        found = fit_shapes(bench_of(exact, np.random.default_rng(seed), declared), MESH)
        assert found.converged
        for name, value in TRUTH.items():
            x = found.parameters[name]
            held += x.low < value < x.high
            assert x.value == pytest.approx(value, rel=0.25)
    print(f"{held} of 45 intervals hold the truth")
    assert held >= 39
    assert found.parameters["EI_body"].high < 1.05 * found.parameters["EI_body"].low
    assert found.offsets == pytest.approx([2e-3] * 3, abs=1.5e-3)


def test_one_table_of_tips_does_not_identify_two_stiffnesses(exact):
    whole, tail, bent = bench_of(exact, np.random.default_rng(0)).shapes
    assert identifiable_parameters([whole]) == ["EI_body"]
    assert identifiable_parameters([whole._replace(joint=whole.tip)]) == ["EI_body", "EI_tail"]
    assert identifiable_parameters([tail, bent]) == ["EI_tail", "K_Q"]


@pytest.mark.slow
def test_pressures_with_the_wrong_sign_are_refused(exact):
    bench = bench_of(exact, np.random.default_rng(0))
    turned = bench.shapes[2]._replace(tip=-bench.shapes[2].tip)
    with pytest.raises(InputError, match="bent.csv: the model bends to the other side"):
        fit_shapes(bench._replace(shapes=(*bench.shapes[:2], turned)), MESH)


def ring(alpha, t, first=0.01, EI=0.038, zero=0.0):
    """Returns the tip [m] of a uniform 0.37 m cantilever released at `first`: eight modes."""
    L, m = 0.37, 0.7
    tip = np.zeros_like(t)
    for n in range(8):
        guess = (n + 0.5) * math.pi
        beta = brentq(lambda x: math.cos(x) + 1.0 / math.cosh(x), guess - 0.4, guess + 0.4)
        omega = beta**2 / L**2 * math.sqrt(EI / m)
        rate = 0.5 * alpha * omega**2
        turn = np.emath.sqrt(rate**2 - omega**2)
        slow, fast = -rate + turn, -rate - turn
        free = (fast * np.exp(slow * t) - slow * np.exp(fast * t)) / (fast - slow)
        tip += 12.0 * first / beta**4 * np.real(free)
    return tip + zero


OMEGA = 3.51602 / 0.37**2 * math.sqrt(0.038 / 0.7)


def test_the_fit_decay_the_first_mode_is_half_alpha_omega_squared():
    t = np.arange(0.0, 12.0, 0.02)
    found = fit_decay(t, ring(4e-3, t, zero=3e-3))
    assert 2.0 * math.pi * found.frequency == pytest.approx(OMEGA, rel=1e-3)
    assert found.rate == pytest.approx(0.5 * 4e-3 * OMEGA**2, rel=0.01)
    assert found.damping_time == pytest.approx(4e-3, rel=0.01)
    with pytest.raises(InputError, match="no decaying oscillation"):
        fit_decay(t, np.random.default_rng(0).normal(size=len(t)))


@pytest.mark.slow
@pytest.mark.parametrize("declared", [2e-4, None])
def test_alpha_from_the_full_beam_equals_that_of_the_closed_form(declared):
    """Uniform rod without air: alpha's interval holds the truth, the factor on EI is 1."""
    alpha = 6e-3
    t = np.arange(0.0, 8.0, 0.02)
    tip = ring(alpha, t, zero=1e-3) + 2e-4 * np.random.default_rng(1).normal(size=len(t))
    robot = robot_of(EI_tail=0.038)
    bench = Bench(table_of(), robot, (), RingDown("ring.csv", t, tip, declared, 0.0))
    found = fit_ring_down(bench, numerics=MESH)
    x = found.damping_time
    print(x, found.stiffness, found.mean_square)
    assert found.converged and x.determined
    assert x.low < alpha < x.high and x.high < 1.15 * x.low
    assert found.stiffness.value == pytest.approx(1.0, abs=3e-3)
    assert found.mean_square < 1.3


BENCH = f"""\
name = "bench"

{ROBOT_TABLE}
[[tip_load]]
file = "whole.csv"

[[tip_load]]
file = "tail.csv"
clamped = "joint"

[[pressure]]
file = "bent.csv"
"""


def write_bench(folder, exact):
    bench = bench_of(exact, np.random.default_rng(3))
    for x in bench.shapes:
        if x.kind == "tip_load":
            rows = ["force_N,tip_m", *(f"{f},{y}" for f, y in zip(x.force, x.tip, strict=True))]
        else:
            rows = ["p_front_Pa,p_rear_Pa,tip_m"]
            rows += [f"{a},{b},{y}" for (a, b), y in zip(x.pressure, x.tip, strict=True)]
        (folder / x.name).write_text("\n".join(rows) + "\n")
    (folder / "bench.toml").write_text(BENCH)
    return folder / "bench.toml"


@pytest.mark.slow
def test_the_command_writes_the_identified_parameters(exact, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(statics.fit_shapes, "__defaults__", (MESH,))
    path, out = write_bench(tmp_path, exact), tmp_path / "out"
    assert main(["calibrate", "statics", str(path), "--out", str(out)]) == 0
    found = json.loads((out / "statics.json").read_text())
    for name, value in TRUTH.items():
        assert found["parameters"][name]["low"] < value < found["parameters"][name]["high"]
    assert [x["offset_m"] for x in found["tables"]] == pytest.approx([2e-3] * 3, abs=1.5e-3)
    assert all(x["rms_residual_m"] < 2.0 * NOISE for x in found["tables"])
    assert list(found["taken_as_given"]) == ["damping_time"]
    model = tomllib.loads((out / "model.toml").read_text())
    assert model["robot"].keys() == {"EI_body", "EI_tail"} and "K_Q" in model["parameters"]
    assert {x.name for x in out.glob("*.png")} == {"whole.png", "tail.png", "bent.png"}
    assert "EI_body" in capsys.readouterr().out


class Stopped(Exception):
    """Ends a command."""


@pytest.mark.slow
def test_the_ring_down_starts_from_the_identified_stiffnesses(exact, tmp_path, monkeypatch):
    robots = []

    def stop(bench, robot):
        robots.append(robot)
        raise Stopped

    monkeypatch.setattr(statics.fit_shapes, "__defaults__", (MESH,))
    monkeypatch.setattr("calibration.bench.ring_down.fit_ring_down", stop)
    path = write_bench(tmp_path, exact)
    path.write_text(BENCH + '\n[[ring_down]]\nfile = "ring.csv"\n')
    t = np.arange(0.0, 8.0, 0.005)
    tip = 0.02 * np.exp(-0.5 * t) * np.cos(6.0 * t)
    rows = "".join(f"{a:.3f},{b:.6f}\n" for a, b in zip(t, tip, strict=True))
    (tmp_path / "ring.csv").write_text(f"t_s,tip_m\n{rows}")
    with pytest.raises(Stopped):
        main(["calibrate", "statics", str(path), "--out", str(tmp_path / "out")])
    (robot,) = robots
    for found, given, name in (
        (robot.body.EI, 0.038, "EI_body"),
        (robot.tail.EI, 0.0058, "EI_tail"),
    ):
        assert abs(found - TRUTH[name]) < abs(given - TRUTH[name])


@pytest.mark.parametrize(
    ("file", "rows", "text"),
    [
        ("whole.csv", "force_N,tip_m\n0.1,0.01\n0.2,0.02\n", "2 rows under the header"),
        ("whole.csv", "force_N,tip_m\n.1,.01\n.2,.02\n.15,.015\n.3,.03\n.4,.04\n",
         "line 4: force_N = 0.15 after 0.2; the load must increase"),
        ("whole.csv", "force_N,tip_m\n.1,.01\n.2,nan\n.3,.03\n.4,.04\n.5,.05\n",
         "line 3, column tip_m: given nan; allowed a finite number"),
        ("whole.csv", "force_N,tip_m\n.1,10\n.2,20\n.3,30\n.4,40\n.5,50\n",
         "column tip_m: given a peak of 50; allowed peaks of 3.7e-05 to 0.37 m"),
        ("whole.csv", "force_N,tip_m\n10,.01\n20,.02\n30,.03\n40,.04\n50,.05\n",
         "forces are in newtons: 1 g weighs 0.00981 N"),
        ("whole.csv", "force_N,tip_m\n.1,-.01\n.2,-.02\n.3,-.03\n.4,-.04\n.5,-.05\n",
         "tip_m decreases as force_N increases"),
        ("tail.csv", "force_N,tip_m,joint_m\n.1,.01,0\n.2,.02,0\n.3,.03,0\n.4,.04,0\n.5,.05,0\n",
         'joint_m is not allowed with clamped = "joint"'),
        ("bent.csv", "p_front_Pa,p_rear_Pa,tip_m\n1,0,.01\n2,0,.02\n3,0,.03\n4,0,.04\n5,0,.05\n",
         "pressures are in pascal, not kPa or psi"),
        ("bent.csv", "p_front_Pa,p_rear_Pa,tip_m\n1e4,0,.01\n2e4,0,.02\n1e4,0,.01\n"
         "4e4,0,.04\n5e4,0,.05\n", "one of the pressures must increase"),
        ("ring.csv", "t_s,tip_m\n0,.01\n.1,.02\n.2,.01\n.3,-.01\n.4,-.02\n",
         "the period is about 1.1 s. Record 3 periods or more"),
    ],
)  # fmt: skip
def test_a_bad_table_is_refused_in_one_line(exact, tmp_path, file, rows, text):
    path = write_bench(tmp_path, exact)
    if file == "ring.csv":
        path.write_text(BENCH + '\n[[ring_down]]\nfile = "ring.csv"\n')
    (tmp_path / file).write_text(rows)
    with pytest.raises(InputError) as refusal:
        load_bench(path)
    assert text in str(refusal.value) and "\n" not in str(refusal.value)


def test_the_documented_bench_file_is_valid():
    path = ROOT / "docs" / "bench.toml"
    table = validate(StaticsTable, read_toml(path), str(path))
    assert len(table.tip_load) == 2 and table.ring_down[0].air_density == 1.2


def test_a_bench_without_tables_is_refused(tmp_path):
    path = tmp_path / "bench.toml"
    path.write_text(BENCH.split("[[tip_load]]")[0])
    with pytest.raises(InputError, match="no table; add"):
        load_bench(path)


CHAMBERS = (("head", (0.02, 0.1), 1.0), ("middle", (0.11, 0.19), 1.3), ("rear", (0.2, 0.28), 0.7))
THREE = BENCH.replace(
    "front_chamber = [0.02, 0.145]\nrear_chamber = [0.155, 0.28]\n", ""
) + "".join(
    f'[[actuators]]\nkind = "pneumatic"\nname = "{name}"\n'
    f"span = {list(span)}\nK_Q_ratio = {ratio}\n"
    for name, span, ratio in CHAMBERS
)


def arcs(pressures):
    """Returns the tip [m] of circular arcs under the pressures of the three chambers."""
    angle, y, at = 0.0, 0.0, 0.0
    for (_, (near, far), ratio), p in zip(CHAMBERS, pressures, strict=True):
        turn = ratio * TRUTH["K_Q"] * p * (far - near) / 0.038
        y += (near - at) * math.sin(angle)
        y += (far - near) * math.sin(angle + 0.5 * turn) * np.sinc(0.5 * turn / math.pi)
        angle, at = angle + turn, far
    return y + (0.37 - at) * math.sin(angle)


@pytest.mark.slow
def test_a_bench_of_three_chambers_identifies_K_Q(tmp_path):
    p = np.stack([PRESSURES, 0.5 * PRESSURES, -0.4 * PRESSURES], axis=1)
    rows = "".join(f"{a},{b},{c},{arcs((a, b, c))}\n" for a, b, c in p)
    (tmp_path / "bent.csv").write_text(f"p_head_Pa,p_middle_Pa,p_rear_Pa,tip_m\n{rows}")
    text = THREE[: THREE.index("[[tip_load]]")] + THREE[THREE.index("[[pressure]]") :]
    (tmp_path / "bench.toml").write_text(text)
    found = fit_shapes(load_bench(tmp_path / "bench.toml"), MESH)
    assert list(found.parameters) == ["K_Q"]
    assert found.parameters["K_Q"].value == pytest.approx(TRUTH["K_Q"], rel=3e-3)


def test_a_bench_with_two_lists_of_chambers_is_refused(tmp_path):
    path = tmp_path / "bench.toml"
    path.write_text(THREE.replace("height = 0.03", "height = 0.03\nrear_chamber = [0.155, 0.28]"))
    with pytest.raises(InputError, match=r"robot.rear_chamber: .*\[\[actuators\]\] lists all"):
        load_bench(path)
