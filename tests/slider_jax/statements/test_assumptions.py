"""Assumptions: their ranges, the printed pressure, and the robot that they make."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.actuation import FirstOrderLag, SquareWave
from slider_jax.beam.parameters import SLIDER, Numerics
from slider_jax.dynamics.model import make_mesh
from slider_jax.dynamics.statics import Loads, at_rest_under
from slider_jax.statements.assumptions import RANGES, Assumptions, from_unit, to_unit
from slider_jax.statements.quantities import STATIC_PRESSURE, static_tip
from slider_jax.statements.switched_lag import SwitchedLag


def test_the_built_in_robot_is_within_all_ranges_and_returns_from_the_unit_box():
    again = from_unit(to_unit(Assumptions()))
    for name, one in RANGES.items():
        value = float(getattr(Assumptions(), name))
        assert one.low <= value <= one.high, name
        assert float(getattr(again, name)) == pytest.approx(value, rel=1e-12, abs=1e-15), name


def test_the_continuous_start_is_the_periodic_state_of_the_lag():
    """Ten periods of the exact lag of a square wave, against the closed form."""
    f, k, steps = 3.0, 0.087, 40
    wave, law = SquareWave(f, 1e5, 0.1), FirstOrderLag(k)
    t = np.arange(10 * steps + 1) / (f * steps)
    p, found = jnp.asarray(0.0), []
    for begin, end in zip(t[:-1], t[1:], strict=True):
        p = law.advance(p, wave.segment(jnp.asarray(begin), jnp.asarray(end)))
        found.append(float(p))
    closed = SwitchedLag(f, 1e5, k, -1.0, 0.1).at(jnp.asarray(t[1:]))
    assert np.max(np.abs(np.array(found) - closed)[-steps:]) < 1e-3 * 1e5


@pytest.mark.parametrize(("start", "share"), [(1.0, 1.0 - np.exp(-1.0 / 0.6)), (0.0, 0.0)])
def test_the_printed_pressure_after_a_switch(start, share):
    """p_0 = p_set (1 - exp(-1/(2 f k))), and p_0 = 0; the sign is that of p_set."""
    f, k = 3.0, 0.1
    wave = SwitchedLag(f, 2e5, k, start)
    just_after = 1e-6
    assert float(wave.at(jnp.asarray(just_after))) == pytest.approx(2e5 * share, abs=10.0)
    half = 0.5 / f
    assert float(wave.at(jnp.asarray(half + just_after))) == pytest.approx(-2e5 * share, abs=10.0)
    # Before the switch, the pressure has decayed from p_0 for half a period.
    end = 1.0 - np.exp(-half / k) * (1.0 - share)
    assert float(wave.at(jnp.asarray(half))) == pytest.approx(2e5 * end)


def test_the_static_tip_agrees_with_the_beam():
    """The closed form and the equilibrium of the planar program, with a short adapter."""
    assumed = replace(Assumptions(), adapter=0.02, EI_body=0.02)
    model = assumed.head_fixed(1.0)
    loads = Loads(jnp.zeros(2), STATIC_PRESSURE * jnp.ones(2))
    rest = at_rest_under(model, loads, Numerics(tail_cells=20, body_cells=160))
    assert bool(rest.ok)
    tip = float(jnp.abs(rest.shape[1, 0]))
    assert tip == pytest.approx(float(static_tip(assumed)), rel=5e-3)


def test_the_adapter_stiffens_the_end_of_the_body():
    robot = replace(Assumptions(), adapter=0.03).robot(0.07, 0.0058)
    mesh = make_mesh(robot, Numerics(tail_cells=7, body_cells=149))
    EI = np.asarray(mesh.structure.EI)
    assert EI[:7] == pytest.approx(0.0058) and EI[8:21] == pytest.approx(1.0)
    assert EI[23:] == pytest.approx(0.038)
    assert float(robot.length) == pytest.approx(SLIDER["body_length"] + 0.07)


def test_assumptions_are_differentiable():
    slope = jax.grad(lambda K_Q: static_tip(replace(Assumptions(), K_Q=K_Q)))(4.79e-7)
    step = 1e-10
    both = [static_tip(replace(Assumptions(), K_Q=4.79e-7 + d)) for d in (step, -step)]
    assert float(slope) == pytest.approx(float(both[0] - both[1]) / (2 * step), rel=1e-5)
