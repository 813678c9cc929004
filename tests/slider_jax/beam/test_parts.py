"""Tests of parts whose properties vary: cell means, closed forms of statics, point masses."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.beam.parameters import Numerics, Robot
from slider_jax.beam.parts import RobotPart
from slider_jax.dynamics.model import Model, make_mesh
from slider_jax.dynamics.statics import Loads
from tests.support.helpers import arrays, static_state, uniform

L, FORCE = 0.4, 0.002
MESH = Numerics(tail_cells=8, body_cells=33)


def part(lengths, **properties):
    given = {"linear_density": 0.7, "EI": 0.04, "EA": 1e6, "damping_time": 0.0, "height": 0.03}
    values = {
        k: jnp.asarray(v, float) if np.ndim(v) else v for k, v in (given | properties).items()
    }
    return RobotPart(lengths=jnp.asarray(lengths, float) if np.ndim(lengths) else lengths, **values)


def rod(lengths, **properties) -> Model:
    """Returns a passive clamped rod in air: a body with varying properties and a uniform tail."""
    body = part(lengths, **properties)
    tail = part(L - float(body.length), EI=np.asarray(properties["EI"]).flat[-1].item())
    base = uniform()
    robot = Robot(body, tail, ((0.02, 0.1), (0.1, 0.2)), 0.0)
    return arrays(replace(base, robot=robot))


def tip_under(model: Model, numerics=MESH) -> float:
    """Returns the tip's displacement [m] under the small transverse force `FORCE`."""
    loads = Loads(jnp.array([0.0, FORCE]), jnp.zeros(2))
    found = static_state(model, loads, numerics)
    assert bool(found.ok)
    return float(found.shape[1, 0])


def test_a_jump_inside_a_cell_divides_the_cell():
    x = part([0.1, 0.3], EI=[[1.0, 1.0], [4.0, 4.0]], height=[[0.02, 0.02], [0.04, 0.04]])
    near, far = np.array([0.0, 0.09, 0.2]), np.array([0.09, 0.13, 0.3])
    np.testing.assert_allclose(x.cell_mean("height", near, far), [0.02, 0.035, 0.04])
    np.testing.assert_allclose(x.cell_mean("EI", near, far), [1.0, 1.0 / (0.25 + 0.75 / 4.0), 4.0])
    np.testing.assert_allclose(x.cell_mean("EA", near, far), 1e6)


def test_the_mean_of_a_linear_profile_is_exact():
    x = part([0.25, 0.15], linear_density=[[1.0, 2.0], [2.0, 0.5]])
    nodes = np.linspace(0.0, 0.4, 8)
    means = x.cell_mean("linear_density", nodes[:-1], nodes[1:])
    whole = np.interp(np.linspace(0.0, 0.4, 70001), [0.0, 0.25, 0.4], [1.0, 2.0, 0.5])
    fine = 0.5 * (whole[1:] + whole[:-1])
    np.testing.assert_allclose(means, fine.reshape(7, -1).mean(1), rtol=1e-8)
    assert float(x.mass) == pytest.approx(0.25 * 1.5 + 0.15 * 1.25)
    assert float(jnp.sum(means) * 0.4 / 7) == pytest.approx(float(x.mass), rel=1e-12)


def test_at_a_jump_a_node_has_the_mean_of_both_values():
    x = part([0.1, 0.3], height=[[0.02, 0.03], [0.05, 0.05]])
    at = x.at_nodes("height", jnp.array([0.0, 0.05, 0.1, 0.2, 0.4]))
    np.testing.assert_allclose(at, [0.02, 0.025, 0.04, 0.05, 0.05])


@pytest.mark.parametrize("cells", [33, 66])
@pytest.mark.parametrize("a", [0.111, 0.2, 0.2873])
@pytest.mark.slow
def test_a_rod_of_two_stiffnesses_bends_as_beam_theory_says(a, cells):
    """The tip's displacement under F is F/3 ((L^3 - (L - a)^3)/EI_1 + (L - a)^3/EI_2)."""
    first, second = 0.08, 0.02
    model = rod([a, 0.32 - a], EI=[[first, first], [second, second]])
    exact = FORCE / 3.0 * ((L**3 - (L - a) ** 3) / first + (L - a) ** 3 / second)
    mesh = Numerics(tail_cells=cells // 4, body_cells=cells)
    error = abs(tip_under(model, mesh) / exact - 1.0)
    print(f"jump at {a} m, {cells} cells: relative error {error:.1e}")
    assert error < 0.5 / cells**2 + 2e-5  # the last part is the nonlinearity of the large bend


@pytest.mark.slow
def test_a_tapered_rod_bends_as_beam_theory_says():
    """EI falls linearly: the displacement is the integral of F x^2/EI(x), x from the tip."""
    model = rod([0.32], EI=[[0.08, 0.02]])
    x = np.linspace(0.0, L, 200001)
    stiffness = np.interp(L - x, [0.0, 0.32], [0.08, 0.02])
    exact = np.trapezoid(FORCE * x**2 / stiffness, x)
    assert tip_under(model) == pytest.approx(exact, rel=1e-3)


def test_the_effective_stiffness_of_a_taper_is_the_mean_compliance():
    x = part([0.1, 0.3], EI=[[4.0, 1.0], [2.0, 2.0]])
    compliance = (0.1 * np.log(4.0) / 3.0 + 0.3 / 2.0) / 0.4
    assert float(x.effective_EI) == pytest.approx(1.0 / compliance, rel=1e-12)


def test_another_length_or_stiffness_keeps_the_ratios():
    x = part([0.1, 0.3], EI=[[1.0, 2.0], [4.0, 4.0]])
    y = x.changed(length=0.2, EI=0.5)
    assert float(y.length) == pytest.approx(0.2) and float(y.effective_EI) == pytest.approx(0.5)
    np.testing.assert_allclose(y.lengths / x.lengths, 0.5)
    assert np.ptp(np.asarray(y.EI / x.EI)) < 1e-12
    z = part(0.4, EI=1.0).changed(EI=0.5)
    assert (z.length, z.effective_EI, z.lengths) == (0.4, 0.5, 0.4)


def test_a_point_mass_keeps_mass_and_moment():
    base = uniform()
    masses = jnp.array([[0.123, 0.05], [0.25, 0.02]])
    heavy, light = (make_mesh(replace(base.robot, point_masses=m), MESH) for m in (masses, None))
    added = (heavy.structure.linear_density - light.structure.linear_density) * heavy.grid.ds
    place = float(base.robot.length) - heavy.structure.s
    assert float(jnp.sum(added)) == pytest.approx(0.07)
    assert float(jnp.sum(added * place)) == pytest.approx(0.05 * 0.123 + 0.02 * 0.25)
    assert float(replace(base.robot, point_masses=masses).mass) == pytest.approx(
        float(base.robot.mass) + 0.07
    )


def test_the_slope_of_the_height_conserves_the_momentum_of_the_water():
    """The sum of (H^2)' ds is the difference between both ends, also with jumps of H."""
    base = uniform()
    body = part([0.1, 0.1944], height=[[0.02, 0.05], [0.03, 0.03]])
    tail = part(0.0736, height=0.06)
    mesh = make_mesh(arrays(replace(base.robot, body=body, tail=tail)), MESH)
    x = mesh.structure
    change = jnp.sum(2.0 * x.height * x.height_s * x.ds)
    assert float(change) == pytest.approx(0.02**2 - 0.06**2, rel=1e-12)
