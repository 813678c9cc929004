"""A search by generations: it finds a known optimum, and goes on from where it was killed."""

import numpy as np
import pytest

from slider_jax.errors import InputError
from slider_jax.optimise.loop import CHECKPOINT, differences, run_optimiser, settings_of
from slider_jax.optimise.optimiser import OPTIMISERS, make_optimiser

TOP = np.array([0.3, 0.8, 0.5, 0.02, 0.6, 0.9])
MEMBERS = 24


def hills(members):
    """Of height 1 at TOP, with lower ones around; no value in a corner of the box."""
    off = members - TOP
    value = 1.0 - (off**2).sum(axis=1) - 0.05 * (1.0 - np.cos(12.0 * off)).sum(axis=1)
    return np.where(members[:, 0] > 0.9, np.nan, value)


def evaluated(members, gradients):
    """With central differences where gradients are asked for."""
    if not gradients:
        return hills(members), None
    h = 1e-6 * np.eye(6)
    slopes = [(hills(members + d) - hills(members - d)) / 2e-6 for d in h]
    return hills(members), np.stack(slopes, axis=1)


def settings(name, seed=3):
    return settings_of(make_optimiser(name, MEMBERS, 6), MEMBERS, seed, {"task": "hills"})


def sought(name, generations, folder=None, seed=3, on_generation=lambda g, s: None, resume=False):
    return run_optimiser(
        make_optimiser(name, MEMBERS, 6), evaluated, generations, seed, settings(name, seed),
        folder, resume, on_generation=on_generation,
    )  # fmt: skip


@pytest.mark.parametrize("name", OPTIMISERS)
@pytest.mark.slow
def test_the_global_maximum_is_found(name):
    found = sought(name, 60)
    assert np.all((found.population >= 0.0) & (found.population <= 1.0))
    assert found.score == hills(found.best[None])[0]
    assert found.score > 0.97
    best = [x.best for x in found.history]
    assert best == list(np.maximum.accumulate([x.best_here for x in found.history]))
    assert found.history[0].failed > 0 and found.history[-1].evaluations == 60 * MEMBERS


def test_the_genetic_algorithm_keeps_its_elite():
    found = sought("genetic", 20)
    assert [x.best for x in found.history] == [x.best_here for x in found.history]


class Killed(Exception):
    pass


@pytest.mark.parametrize("name", OPTIMISERS)
def test_an_optimisation_killed_three_times_gives_the_same_result(name, tmp_path):
    whole = sought(name, 15)
    moments = sorted(np.random.default_rng(0).choice(np.arange(1, 14), 3, replace=False))

    def kill_at(moment):
        def on_generation(generation, seconds):
            if generation.number == moment:
                raise Killed

        return on_generation

    for moment in moments:
        with pytest.raises(Killed):
            sought(name, 15, tmp_path, on_generation=kill_at(moment), resume=True)
    again = sought(name, 15, tmp_path, resume=True)
    np.testing.assert_equal(again.history, whole.history)
    np.testing.assert_array_equal(again.population, whole.population)
    np.testing.assert_array_equal(again.best, whole.best)


def test_another_seed_gives_another_population():
    assert not np.array_equal(
        sought("genetic", 2).population, sought("genetic", 2, seed=4).population
    )


def test_a_longer_optimisation_continues_a_shorter_one(tmp_path):
    sought("genetic", 4, tmp_path)
    again = sought("genetic", 9, tmp_path, resume=True)
    np.testing.assert_equal(again.history, sought("genetic", 9).history)


def test_a_checkpoint_is_not_overwritten_without_resume(tmp_path):
    sought("genetic", 2, tmp_path)
    with pytest.raises(InputError, match=r"holds an optimisation; add --resume"):
        sought("genetic", 2, tmp_path)


def test_a_checkpoint_with_other_settings_is_refused(tmp_path):
    sought("genetic", 2, tmp_path)
    with pytest.raises(InputError, match="other settings: seed: given 4, saved 3"):
        sought("genetic", 3, tmp_path, seed=4, resume=True)


@pytest.mark.parametrize("damage", ["cut", "flipped", "other"])
def test_a_damaged_checkpoint_is_refused(tmp_path, damage):
    sought("genetic", 2, tmp_path)
    path = tmp_path / CHECKPOINT
    content = bytearray(path.read_bytes())
    if damage == "flipped":
        content[len(content) // 2] ^= 1
    path.write_bytes({"cut": content[:-50], "flipped": content, "other": b"text"}[damage])
    with pytest.raises(InputError, match="is damaged or is not a checkpoint"):
        sought("genetic", 3, tmp_path, resume=True)


@pytest.mark.parametrize("name", OPTIMISERS)
def test_a_population_that_is_too_small_is_refused(name):
    few = OPTIMISERS[name][0] - 1
    with pytest.raises(InputError, match=f"--population: given {few}; allowed {few + 1} or more"):
        make_optimiser(name, few, 6)


def test_a_generation_may_fail_completely():
    def nothing(members, gradients):
        return np.full(len(members), np.nan), None

    found = run_optimiser(make_optimiser("genetic", MEMBERS, 6), nothing, 3, 0, {})
    assert found.history[-1].failed == MEMBERS and found.score == -np.inf


def test_differences_name_their_place():
    one = {"seed": 1, "robot": {"EI": [1.0, 2.0], "L": 3}, "gone": None}
    other = {"seed": 1, "robot": {"EI": [1.0, 2.5], "L": 3}, "new": "x"}
    assert differences(one, one) == []
    assert differences(one, other) == [
        "robot.EI.1: given 2.0, saved 2.5", 'new: given null, saved "x"'
    ]  # fmt: skip
