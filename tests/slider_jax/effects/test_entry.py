"""Tests of the forces at the water's surface: wet part, weight, and effects with added mass."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.effects import Gravity, NormalDrag, ReactiveForce
from slider_jax.effects.base import force_of
from slider_jax.effects.water.amplitude_added_mass import AmplitudeAddedMass
from slider_jax.effects.water.edge_vortices import EdgeVortices
from slider_jax.effects.water.tail_added_mass import TailAddedMass
from tests.support.helpers import SMALL, swimmer


@pytest.fixture(scope="module")
def section():
    """A section of the driven robot; 30 % of each cell is wet, and it enters at 4 1/s."""
    run = rollout(swimmer(), TimeGrid(1e-3, 100), lambda x: x.section(), SMALL)
    found = {f.name: getattr(run.saved, f.name) for f in dataclasses.fields(run.saved)}
    last = {k: x if x is None or jnp.ndim(x) == 0 else x[-1] for k, x in found.items()}
    x = dataclasses.replace(run.saved, **last)
    return dataclasses.replace(
        x, wet=jnp.full_like(x.u_n, 0.3), wetting=jnp.full_like(x.u_n, 4.0), area=x.s * 0.0 + 7e-4
    )


def test_the_water_acts_on_the_wet_part_and_weight_everywhere(section):
    dry = dataclasses.replace(section, wet=None)
    drag, weight = NormalDrag(3.0), Gravity(9.81, density=1000.0)
    np.testing.assert_allclose(
        force_of(drag, section)[1], 0.3 * np.asarray(force_of(drag, dry)[1]), rtol=1e-12
    )
    F_tau, F_n = force_of(weight, section)
    net = 9.81 * (section.linear_density - 0.3 * 0.7) / (1.0 + section.strain)
    np.testing.assert_allclose(jnp.hypot(F_tau, F_n), net, rtol=1e-12)


def test_added_mass_takes_momentum_on_entry_and_none_on_exit(section):
    effects = ReactiveForce(1.0), TailAddedMass(0.5), AmplitudeAddedMass(0.2), EdgeVortices(2.0)
    leaves = dataclasses.replace(section, wetting=-section.wetting)
    for effect in effects:
        entering, leaving = effect.entry_force(section), effect.entry_force(leaves)
        assert float(jnp.abs(jnp.stack(leaving)).max()) == 0.0
        assert float(jnp.abs(entering[0]).max()) == 0.0
        assert float(jnp.min(-entering[1] * section.u_n)) >= 0.0
        assert float(jnp.abs(entering[1]).max()) > 0.0
    m_A = effects[0].added_mass(section.height)
    np.testing.assert_allclose(effects[0].entry_force(section)[1], -4.0 * m_A * section.u_n)
    in_body = np.asarray(section.in_tail) == 0.0
    assert np.all(np.asarray(effects[1].entry_force(section)[1])[in_body] == 0.0)
