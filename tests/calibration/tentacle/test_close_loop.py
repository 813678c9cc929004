"""The search for effects that the arm lacks, with an arm that needs no iteration."""

from dataclasses import fields

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from calibration.discrepancy.scores import score
from calibration.discrepancy.verdict import CLASS, IDENTIFIED, NOTHING
from calibration.inference.problem import normal_equations, summed
from calibration.tentacle.arm import (
    LENGTH,
    MARKER_NODES,
    POINTS,
    ArmParameters,
    ArmShape,
    arm_parts,
    arm_tendons,
)
from calibration.tentacle.candidates import ARM_EFFECTS, candidates_of, effect_values, with_effects
from calibration.tentacle.close_loop import (
    above_floor,
    close_arm_loop,
    gain_by_chance,
    noise_floor_of,
    repeated_runs,
    search_record,
)
from calibration.tentacle.effects.capstan_friction import CapstanFriction
from calibration.tentacle.effects.tendon_place import TendonPlace
from calibration.tentacle.effects.tension_offset import TensionOffset
from calibration.tentacle.fit import ArmProblem, fit_arm
from calibration.tentacle.runs import ArmRuns
from slider_jax.rod.rod import rod_shape

TENSIONS = np.array(
    [(1.5, 0), (3, 0), (4.5, 0), (5.5, 0), (6, 0), (0, 1.5), (0, 3), (0, 3.5), (0, 5), (0, 6),
     (3, 1.5), (3, 3), (6, 3), (4, 6)], float,
)  # fmt: skip
SESSIONS = tuple("BABBABABAABBBA")
TRUE = np.array([4e5, 1200.0])
NOISE = 1e-3


@eqx.filter_jit
def light_arms(base, values, tensions, strains, share):
    """The shapes of an arm with small strains, whose weight acts as a further stiffness."""

    def one(values, tensions, strains):
        stated = arm_parts(ArmParameters(*base), share * tensions, strains)
        parts = with_effects(stated, values)
        rod = parts.rod

        def pull(q):
            return sum(x.tension * x.length(rod, q) for x in parts.tendons)

        load = -jax.grad(pull)(rod.unloaded) / rod.ds[:, None]
        hanging = rod.weight * (LENGTH - rod.s) ** 3 / 3.0
        stiffness = rod.elasticity.at[:, 1:3].add(hanging[:, None])
        found = rod.unloaded + load / stiffness
        shape = rod_shape(rod, found)
        frames = shape.frame[MARKER_NODES]
        markers = shape.position[MARKER_NODES] + jnp.einsum("kij,kj->ki", frames, parts.offsets)
        return ArmShape(markers + parts.base, found, jnp.array(True))

    return jax.vmap(one)(values, tensions, strains)


def measured(effects, seed=0, sessions=SESSIONS):
    """The problem of runs with these `effects` and with noise of 1 mm."""
    candidates = candidates_of(sessions)
    empty = ArmRuns(
        tuple(f"run{i}" for i in range(len(TENSIONS))), TENSIONS, np.zeros((14, 4, 3)), sessions
    )
    source = ArmProblem(empty, candidates, light_arms)
    theta = source.stated.copy()
    theta[:2] = TRUE
    for name, value in effects.items():
        theta[source.names.index(name)] = value
    noise = NOISE * np.random.default_rng(seed).standard_normal((14, 4, 3))
    runs = empty._replace(markers=source.markers(theta) + noise)
    return ArmProblem(runs, candidates, light_arms), theta


@pytest.mark.parametrize(
    "name, value",
    [
        ("tension_gain.tendon_1 in session A", -0.08),
        pytest.param("marker_place.along_2 in session B", 0.006, marks=pytest.mark.slow),
        pytest.param("base_tilt.about_x", 0.02, marks=pytest.mark.slow),
    ],
)
def test_an_effect_in_the_data_is_found_alone(name, value):
    problem, theta = measured({name: value})
    search = close_arm_loop(problem)
    first = search.rounds[0]
    assert name in (first.chosen, *first.equivalent)
    assert search.statuses[first.chosen] in (IDENTIFIED, CLASS)
    assert [x.chosen for x in search.rounds[1:]] == [None]
    assert search.used.free == first.fit.free
    assert search.held_out_mm["predictions"] < search.held_out_mm["base"]
    assert search.verdict == search.statuses[first.chosen]
    if first.chosen == name:
        i = problem.names.index(name)
        np.testing.assert_allclose(search.used.theta[i], value, rtol=0.1)
    record = search_record(problem, search)
    assert record["rounds"][0]["candidates"][0]["gain"] > record["rounds"][0]["least_gain"]
    assert set(record["predictions"]) == {"E", "density", first.chosen}


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(i, marks=pytest.mark.slow) for i in range(1, 6))]
)
def test_nothing_is_found_without_an_effect(seed):
    problem, theta = measured({}, seed)
    search = close_arm_loop(problem)
    assert [x.chosen for x in search.rounds] == [None]
    assert search.statuses == {} and search.used.free == (0, 1)
    np.testing.assert_allclose(search.start.theta[:2], TRUE, rtol=0.05)
    assert search.verdict == NOTHING


def test_a_run_that_errs_as_a_whole_raises_the_threshold():
    """All errors of a run are equal. With independent errors, 5 % of chance is a gain of 11."""
    rng = np.random.default_rng(1)
    J = {(i, "markers"): rng.standard_normal((40, 1)) * np.ones(12) for i in range(14)}
    whole = {key: rng.standard_normal() * np.ones(12) for key in J}
    alone = {key: rng.standard_normal(12) for key in J}
    free, many = np.array([0]), np.arange(1, 40)
    own = gain_by_chance(normal_equations(alone, J), free, many)
    assert 6.0 < own < 14.0
    assert gain_by_chance(normal_equations(whole, J), free, many) > 3.0 * own


def test_an_effect_of_one_sign_in_all_runs_exceeds_the_threshold():
    """Random signs reduce the sum of 14 equal numbers from 14 to about 8 (2 %)."""
    rng = np.random.default_rng(1)
    J = {(i, "markers"): rng.standard_normal((5, 12)) for i in range(14)}
    residual = {key: 3.0 * x[2] + rng.standard_normal(12) for key, x in J.items()}
    blocks = normal_equations(residual, J)
    best = score("x", np.array([2]), np.array([0]), blocks, 1.0, 4).gain
    unit = (sum(x.c for x in blocks) - summed(blocks)[1][0] ** 2 / summed(blocks)[0][0, 0]) / 167
    assert gain_by_chance(blocks, np.array([0]), np.arange(1, 5)) < 0.5 * best / unit


def test_the_floor_is_the_error_that_each_session_has_alone():
    """Errors of 100 pairs with the same law: the floor is their mean size, to 5 %."""
    names = tuple(f"run{i}" for i in range(200))
    tensions = np.repeat(3.0 * np.arange(1, 101), 2)[:, None] * [[1.0, 0.0]]
    errors = 0.01 * np.random.default_rng(2).standard_normal((200, 4, 3))
    runs = ArmRuns(names, tensions, errors, ("A", "B") * 100)
    assert repeated_runs(runs) == [(i, i + 1) for i in range(0, 200, 2)]
    expected = 1e3 * np.linalg.norm(errors, axis=2).mean()
    np.testing.assert_allclose(noise_floor_of(runs, np.zeros((200, 4, 3))), expected, rtol=0.05)
    common = np.full((200, 4, 3), 0.02)
    np.testing.assert_allclose(noise_floor_of(runs, common), expected, rtol=0.05)
    assert noise_floor_of(runs._replace(sessions=("",) * 200), runs.markers) is None


def test_few_pairs_determine_the_floor_roughly():
    """Limits of the F-test at 5 %: F(14, 2) is 19.4, F(14, 1000) is 1.70 (published tables)."""
    for pairs, limit in ((2, 19.42), (1000, 1.702)):
        assert not above_floor(0.99 * limit**0.5, 1.0, 14, pairs)
        assert above_floor(1.01 * limit**0.5, 1.0, 14, pairs)
    assert above_floor(1.0, None, 14, 0)


def test_effects_at_their_nulls_change_nothing_and_each_parameter_changes_something():
    strains = jnp.zeros((POINTS, 4)).at[:, 1].set(3.0)
    parts = arm_parts(ArmParameters(), jnp.array([2.0, 1.0]), strains)
    nulls = np.concatenate([[f.metadata["prior"].null for f in fields(x)] for x in ARM_EFFECTS])
    changed_by = eqx.filter_jit(with_effects)
    same = changed_by(parts, jnp.asarray(nulls))
    assert eqx.tree_equal(parts, same, rtol=1e-14, atol=1e-14)
    for i in range(len(nulls)):
        changed = changed_by(parts, jnp.asarray(nulls).at[i].set(1e-3))
        assert not eqx.tree_equal(parts, changed, rtol=1e-7, atol=1e-9), i


@pytest.mark.parametrize(
    "name, value", [("capstan_friction.mu", 0.3), ("strain_stiffening.growth", 20.0)]
)
def test_the_first_guess_changes_no_marker(name, value):
    """Shapes from the unloaded arm and from another arm agree to 1e-8 m, and so do derivatives."""
    cold, theta = measured({name: value})
    warm = ArmProblem(cold.runs, cold.candidates, light_arms)
    warm.markers(np.concatenate([2.0 * TRUE, theta[2:]]))
    cold = ArmProblem(cold.runs, cold.candidates, light_arms)
    expected = cold.markers(theta)
    np.testing.assert_allclose(warm.markers(theta), expected, atol=1e-8)
    step = np.eye(len(theta))[0] * 1e-3 * theta[0]
    ahead, behind = (cold.markers(theta + sign * step) for sign in (1.0, -1.0))
    slope = (ahead - behind) / (2.0 * step[0])
    np.testing.assert_allclose(warm.slopes(theta, [0])[0], slope, atol=5e-3 * np.abs(slope).max())


def test_effects_of_a_session_act_in_its_runs_only():
    candidates = candidates_of(("A", "B"))
    theta = np.zeros(len(candidates))
    names = [x.name for x in candidates]
    theta[names.index("tension_offset.both in session B")] = 0.3
    theta[names.index("tension_offset.both")] = 0.1
    column = candidates[names.index("tension_offset.both")].column
    values = effect_values(theta, candidates, ("A", "B", ""))
    np.testing.assert_allclose(values[:, column], [0.1, 0.4, 0.25])
    assert not any(x.session for x in candidates_of(("A", "A")))


def test_offset_friction_and_place_of_the_tendons():
    """A tendon without tension stays slack; the tension falls by exp(-mu angle); 1 mm is 1 mm."""
    strains = jnp.zeros((POINTS, 4)).at[:, 2].set(4.0)
    parts = arm_parts(ArmParameters(), jnp.array([2.0, 0.0]), strains)
    tensions = [float(x.tension) for x in TensionOffset(both=0.3, tendon_1=0.1).on(parts).tendons]
    np.testing.assert_allclose(tensions, [1.6, 0.0])
    assert TensionOffset(both=3.0).on(parts).tendons[0].tension == 0.0
    loss = CapstanFriction(mu=0.2).on(parts).tendons[0].share[:20] / parts.tendons[0].share[:20]
    np.testing.assert_allclose(loss, np.exp(-0.2 * 4.0 * parts.rod.s[:20]), rtol=1e-9)
    moved = TendonPlace(at_base=1e-3, at_end=1e-3, angle=0.1).on(parts).tendons
    for before, after in zip(arm_tendons(jnp.ones(2)), moved, strict=True):
        (n, b), (n2, b2) = np.asarray(before.offset)[:20].T, np.asarray(after.offset)[:20].T
        np.testing.assert_allclose(np.hypot(n2, b2) - np.hypot(n, b), 1e-3)
        np.testing.assert_allclose(np.arctan2(b2, n2) - np.arctan2(b, n), 0.1)
        along = np.diff(np.asarray(after.offset)[:20], axis=0) / np.diff(parts.rod.s[:20])[:, None]
        np.testing.assert_allclose(along, np.asarray(after.offset_slope)[:19], rtol=1e-9)


def test_a_held_out_run_has_no_influence_on_the_fit():
    problem, _ = measured({})
    fit = fit_arm(problem, problem.stated, (0, 1), held_out=3)
    problem.runs.markers[3] += 0.1
    again = fit_arm(problem, problem.stated, (0, 1), held_out=3)
    np.testing.assert_allclose(again.theta, fit.theta, rtol=1e-6)
