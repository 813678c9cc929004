"""The terms of the dictionary: null, tangents, basis functions, and use in a model file."""

import importlib
from pathlib import Path
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from calibration.model.extended import candidate_effects
from slider_jax.effects import Readings, dictionary
from slider_jax.effects.check import checked_effects
from slider_jax.effects.functions import Powers, even_powers, odd_powers
from slider_jax.effects.library import DICTIONARY, LIBRARY
from slider_jax.experiment.load import assemble
from slider_jax.simulation.effect_signature import built_in_experiment
from slider_jax.simulation.trial import simulate_trial

FILES = sorted(path.stem for path in Path(dictionary.__file__).parent.glob("[a-z]*.py"))


@pytest.mark.parametrize("name", FILES)
def test_terms_vanish_at_their_nulls_and_have_finite_tangents(name):
    """`checked_effects` refuses a term that does not."""
    module = importlib.import_module(f"slider_jax.effects.dictionary.{name}")
    kinds = checked_effects(module, name, {})
    assert {kind.name() for kind in kinds} <= set(DICTIONARY)
    assert all(prior.null == 0.0 for kind in kinds for prior in kind.priors().values())


def test_the_dictionary_is_no_part_of_the_library():
    assert len(FILES) == 5 and len(DICTIONARY) == 49
    assert not set(DICTIONARY) & (set(LIBRARY) | set(candidate_effects()))


@pytest.mark.parametrize("name", DICTIONARY)
def test_a_term_has_a_basis_function_for_every_parameter_or_for_every_part(name):
    effect = DICTIONARY[name]()
    basis = np.asarray(effect.basis(jnp.linspace(-1.0, 1.0, 5)))
    assert np.isfinite(basis).all() and np.abs(basis).max() > 0.0
    if set(effect.priors()) == {"body", "tail"}:
        assert basis.shape == (5,)
    else:
        assert basis.shape == (len(effect.priors()), 5)


def test_powers_are_constant_beyond_the_largest_visited_state():
    z = jnp.array([-3.0, -1.0, -0.5, 0.5, 1.0, 3.0])
    odd, even = np.asarray(odd_powers(z)), np.asarray(even_powers(z))
    np.testing.assert_allclose(odd[2], [-1.0, -1.0, -0.125, 0.125, 1.0, 1.0])
    np.testing.assert_allclose(odd, -odd[:, ::-1])
    np.testing.assert_allclose(even, np.abs(odd))
    scaled = [kind() for kind in DICTIONARY.values() if issubclass(kind, Powers)]
    assert len(scaled) == 27
    for term in scaled:
        ends = np.asarray(term.basis(term.scale * jnp.array([-3.0, -1.0, 1.0, 3.0])))
        np.testing.assert_allclose(ends[:, [0, 3]], ends[:, [1, 2]])


def test_a_drift_of_the_gain_is_proportional_to_the_reading():
    t = jnp.array([0.0, 1.0, 2.0])
    true = Readings(t, 1e5 * (1.0 + t), -2e5 * t, t, t, t)
    read = DICTIONARY["pressure_reading_gain_drift"](a=0.1, b=0.02).read(true)
    gain = 1.0 + 0.1 * t + 0.02 * t**2
    np.testing.assert_allclose(read.p_front, gain * true.p_front)
    np.testing.assert_allclose(read.p_rear, gain * true.p_rear)
    np.testing.assert_array_equal(read.tip, true.tip)


@pytest.mark.parametrize(("name", "axis"), [("water_sine_along", 0), ("water_sine_across", 1)])
def test_the_water_oscillates_along_one_axis(name, axis):
    t = jnp.linspace(0.0, 1.0, 30)
    velocity = DICTIONARY[name](a=0.1, b=-0.05, frequency=2.7).velocity(t)
    angle = 2.0 * np.pi * 2.7 * t
    expected = 0.1 * jnp.sin(angle) - 0.05 * jnp.cos(angle)
    np.testing.assert_allclose(velocity[axis], expected, atol=1e-12)
    np.testing.assert_array_equal(velocity[1 - axis], 0.0)


def test_damping_terms_have_the_stated_signs():
    """Columns: both signs of the curvature, and both signs of its rate."""
    kappa, rate = jnp.array([2.0, 2.0, -2.0, -2.0]), jnp.array([30.0, -30.0, 30.0, -30.0])
    x = SimpleNamespace(kappa=kappa, kappa_t=rate, EI=1.0, in_tail=jnp.zeros(4))

    def signs(name, **factors):
        moment, _ = DICTIONARY[name](**factors).moment(x, jnp.zeros(4), 1e-3)
        return np.sign(moment).tolist()

    assert signs("moment_of_rate_by_side", body=1.0) == [1, 1, 1, 1]
    assert signs("moment_of_straightening", body=1.0) == [1, 1, -1, -1]
    assert signs("damping_of_body", a=1.0) == [1, -1, -1, 1]
    assert signs("damping_of_body", c=1.0) == [1, -1, 1, -1]
    assert signs("damping_of_tail", a=1.0) == [0, 0, 0, 0]


def test_the_simulation_of_a_model_file_contains_its_terms(tmp_path):
    content = built_in_experiment().model_dump()
    content["numerics"] |= {"nodes": 11, "step": 5e-3}
    content["trials"] = [content["trials"][0] | {"duration": 0.1}]

    def thrust(text):
        (tmp_path / "model.toml").write_text(text)
        experiment = assemble(content, "test", tmp_path, tmp_path / "model.toml")
        return simulate_trial(experiment, declared_drive=True).series["thrust"]

    table = '[[effects]]\nname = "normal_force_on_tail"\nb = {}\nc = {}\n'
    null, changed = thrust(table.format(0.0, 0.0)), thrust(table.format(-5.0, -5.0))
    assert np.isfinite(changed).all() and np.abs(changed - null).max() > 1e-3 * np.abs(null).max()
