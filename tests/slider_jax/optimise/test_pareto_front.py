"""One tail for two tasks, on a coarse robot and a few members."""

import json
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.cli.main import main
from slider_jax.climbing.strides import climb_from_rest
from slider_jax.errors import InputError, SolverError
from slider_jax.experiment.load import assemble, load, to_model
from slider_jax.optimise import loop as optimise, pareto_front as multimodal
from slider_jax.optimise.design_space import to_toml
from slider_jax.optimise.fastest_swimmer import search_fastest
from slider_jax.optimise.optimiser import make_optimiser
from slider_jax.optimise.pareto_front import FrontEffort, FrontPoint, dominated, search_front
from slider_jax.optimise.two_tasks import CLIMB, SWIM, TAIL, TwoTasks, eta
from slider_jax.swimming.gait import to_climber, to_swimmer
from slider_jax.swimming.paper_optimum import swimmer_content
from slider_jax.swimming.performance import next_stride, performance, steady_stride
from slider_jax.swimming.steady_state import find_steady, simulate_strides

BETAS = ("0.000", "0.500", "1.000")


def coarse():
    content = swimmer_content(frequency=5.0, amplitude=365e3, phase=0.2)
    numerics = {"nodes": 17, "step": 0.004}
    return assemble(content | {"numerics": numerics}, "coarse", Path("."))


def optimize(folder, *words):
    file = folder / "tank.toml"
    file.write_text(to_toml(coarse()))
    few = ["--population", "8", "--generations", "2", "--betas", "3", "--steps-per-stride", "48"]
    out = ["--out", str(folder / "out")]
    return main(["optimize", "multimodal", str(file), *few, *out, *words])


@pytest.fixture(scope="module")
def sought(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sought")
    assert optimize(folder) == 0
    return folder / "out"


class Hills:
    """Efficiencies with a known front: a best tail for each task, a best drive for each tail."""

    tails = (0.2, 0.7)

    def __init__(self, modes, folder):
        pass

    def __call__(self, designs, swims, climbs):

        tail, EI = designs[:, TAIL[0]], designs[:, TAIL[1]]
        found = []
        for part, best in ((SWIM, self.tails[0]), (CLIMB, self.tails[1])):
            drive = ((designs[:, part] - 0.3 - 0.4 * tail[:, None]) ** 2).sum(axis=1)
            found.append(0.5 - (tail - best) ** 2 - 0.3 * (EI - 0.5) ** 2 - 0.2 * drive)
        return np.where([swims, climbs], np.stack(found, axis=1), np.nan)


EFFORT = FrontEffort("genetic", 96, 40, 1)
FEW = EFFORT._replace(generations=6)
"""As many members, so that both are one compiled program."""


@pytest.fixture
def hills(monkeypatch):
    monkeypatch.setattr(multimodal, "TaskEfficiencies", Hills)
    return TwoTasks.of(coarse(), steps_per_stride=48)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A front that was not stopped."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(multimodal, "TaskEfficiencies", Hills)
        modes = TwoTasks.of(coarse(), steps_per_stride=48)
        return search_front(modes, 3, FEW, tmp_path_factory.mktemp("whole"))


@pytest.mark.slow
def test_the_front_of_known_hills_is_found(hills, tmp_path):
    """With eta of quadratics the best tail moves evenly with beta, and drives follow it."""
    found = search_front(hills, 3, EFFORT, tmp_path)
    swims, climbs = Hills.tails
    for point in found.points:
        best = climbs + point.beta * (swims - climbs)
        assert point.design[TAIL[0]] == pytest.approx(best, abs=0.03)
        known = 0.5 - np.array([best - swims, best - climbs]) ** 2
        assert point.eta == pytest.approx(eta(point.beta, known[None], found.only)[0], abs=2e-3)
    np.testing.assert_allclose(found.alone, 0.5, atol=5e-3)
    ends = np.array([found.points[-1].efficiencies[0], found.points[0].efficiencies[1]])
    np.testing.assert_allclose(ends, found.alone, rtol=0.01)
    assert dominated(found.points) == []


@pytest.mark.slow
@pytest.mark.parametrize("saves", [8, 20])
def test_an_interrupted_optimisation_resumes(hills, whole, tmp_path, monkeypatch, saves):
    """Stopped after any of its generations; the front is the same to the last bit."""
    kept, count = optimise._save, [0]

    def stop(*given):
        kept(*given)
        count[0] += 1
        if count[0] == saves:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(optimise, "_save", stop)
        with pytest.raises(KeyboardInterrupt):
            search_front(hills, 3, FEW, tmp_path / "broken")
    with pytest.raises(InputError, match="holds an optimisation; add --resume"):
        search_front(hills, 3, FEW, tmp_path / "broken")
    with pytest.raises(InputError, match="betas: given 4, saved 3; give the same"):
        search_front(hills, 4, FEW, tmp_path / "broken", resume=True)
    again = search_front(hills, 3, FEW, tmp_path / "broken", resume=True)
    for one, other in zip(whole.points, again.points, strict=True):
        np.testing.assert_array_equal(one.design, other.design)
    assert whole.evaluations == again.evaluations


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"betas": ', None])
def test_a_damaged_settings_file_is_refused(hills, tmp_path, content):
    search_front(hills, 2, FrontEffort("genetic", 8, 1, 1), tmp_path)
    (tmp_path / "search.json").unlink()
    if content is None:
        (tmp_path / "search.json").mkdir()
    else:
        (tmp_path / "search.json").write_text(content)
    with pytest.raises(InputError, match="search.json: the file is damaged or was not written"):
        search_front(hills, 2, FrontEffort("genetic", 8, 1, 1), tmp_path, resume=True)


def test_a_folder_of_another_kind_of_optimisation_is_refused(hills, tmp_path):
    (tmp_path / "checkpoint.npz").write_bytes(b"of another search")
    with pytest.raises(InputError, match="holds checkpoints of another optimisation"):
        search_front(hills, 2, EFFORT, tmp_path, resume=True)
    assert not (tmp_path / "search.json").exists()
    (tmp_path / "checkpoint.npz").unlink()
    (tmp_path / "search.json").write_text("{}")
    with pytest.raises(InputError, match="this folder holds a multimodal optimisation"):
        search_fastest(hills.task, make_optimiser("genetic", 8, 6), 8, 1, 0, tmp_path, resume=True)


@pytest.mark.slow
def test_a_task_that_no_design_can_do_is_an_error(hills, tmp_path, monkeypatch):
    class Sinks(Hills):
        def __call__(self, designs, swims, climbs):
            return super().__call__(designs, swims, climbs) - np.array([0.0, 1.0])

    monkeypatch.setattr(multimodal, "TaskEfficiencies", Sinks)
    with pytest.raises(SolverError, match="climb_only: no design moves forward"):
        search_front(hills, 3, FEW, tmp_path)


def test_a_robot_that_nothing_resists_is_refused(tmp_path, capsys):
    file = tmp_path / "tank.toml"
    file.write_text(
        to_toml(coarse()).replace('name = "head_drag"\narea = 0.00179', 'name = "gravity"')
    )
    assert main(["optimize", "multimodal", str(file), "--out", str(tmp_path / "out")]) == 2
    assert "effects: no effect resists motion along the body" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_written_experiments_reproduce_the_efficiencies(sought):
    found = json.loads((sought / "multimodal.json").read_text())
    modes = TwoTasks.of(coarse(), steps_per_stride=48)
    assert (sought / "multimodal.png").stat().st_size > 10_000
    assert [x["beta"] for x in found["front"]] == [0.0, 0.5, 1.0]
    for name, x in zip(BETAS, found["front"], strict=True):
        swims, climbs = (load(sought / f"beta_{name}_{task}.toml") for task in ("swim", "climb"))
        assert swims.robot == climbs.robot
        for task, here in ((swims, ""), (climbs, "climb_")):
            trial = task.trials[0]
            drive = (trial.frequency, trial.amplitude, trial.amplitude * trial.rear_ratio)
            wanted = (x[f"{here}frequency"], x[f"{here}front"], x[f"{here}rear"])
            assert drive == pytest.approx(wanted)
        f = swims.trials[0].frequency
        _, swum, ok, _ = eqx.filter_jit(steady_stride)(
            to_swimmer(to_model(swims)), f, modes.task.search
        )
        assert ok and swum.froude_efficiency == pytest.approx(x["E_swim"], rel=1e-4)
        f = climbs.trials[0].frequency
        pinned = to_climber(to_model(climbs), f, x["pin_phase"])
        climbed, ok = jax.jit(climb_from_rest, static_argnums=2)(pinned, f, modes.plan)
        assert ok and float(climbed.efficiency) == pytest.approx(x["E_climb"], rel=1e-3)


def test_a_task_without_weight_may_fail():
    efficiencies = np.array([[0.2, np.nan], [0.1, 0.6]])
    only = np.array([0.2, 0.6])
    np.testing.assert_allclose(eta(1.0, efficiencies, only), [1.0, 0.5])
    np.testing.assert_allclose(eta(0.25, efficiencies, only), [np.nan, 0.875])


def test_a_dominated_point_is_reported():
    def at(beta, *both):
        return FrontPoint(beta, 0.0, np.array(both), np.zeros(11))

    good = [at(0.0, 0.1, 0.9), at(0.5, 0.2, 0.8), at(1.0, 0.3, 0.1)]
    assert dominated(good) == []
    assert dominated([*good[:2], at(1.0, 0.15, 0.8)]) == [1.0]


@pytest.mark.slow
def test_one_steady_stride_stands_for_fifty():
    """Of the work and the thrust of swimming."""
    model, f = to_swimmer(to_model(coarse())), jnp.asarray(5.0)
    modes = TwoTasks.of(coarse(), steps_per_stride=48)
    search = modes.task.search

    @jax.jit
    def both(model):
        carry = find_steady(model, f, search).carry
        now = performance(model, f, next_stride(model, f, carry, search), search)
        later, _ = simulate_strides(model, f, carry, 48, search)
        return now, performance(model, f, next_stride(model, f, later, search), search)

    now, later = both(model)
    for name in ("speed", "power", "thrust", "froude_efficiency"):
        assert getattr(later, name) == pytest.approx(float(getattr(now, name)), rel=2e-3), name


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--betas", "1"], "--betas: given 1; allowed 2 to 101"),
        (["--population", "1"], "--population: given 1; allowed 4 or more individuals"),
        (["--tail-length", "0.1", "0.05"], "--tail-length: given 0.1 0.05; allowed LOW HIGH"),
        (["--EI-tail", "1", "38"], "--EI-tail: given 38; allowed at most 0.38 N m^2"),
        (["--EI-tail", "1", "5e6"], "--EI-tail: given 5e+06; allowed 1e-06 to 100 N m^2"),
    ],
)
def test_invalid_options_are_refused(words, text, tmp_path, capsys):
    assert optimize(tmp_path, *words) == 2
    assert text in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
