"""One tail for two tasks, on a coarse robot and a few members."""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.cli.main import main
from slider_jax.design import to_toml
from slider_jax.experiment import assemble, load, to_model
from slider_jax.gait import swimmer
from slider_jax.modes import Modes, eta
from slider_jax.multimodal import Point, dominated
from slider_jax.paper_swimmer import swimmer_content
from slider_jax.performance import next_stride, performance
from slider_jax.steady import find_steady, strides

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


def told(folder):
    return json.loads((folder / "multimodal.json").read_text())


@pytest.mark.slow
def test_the_ends_are_the_best_of_each_task(sought):
    found = told(sought)
    climbs, _, swims = found["front"]
    assert [x["beta"] for x in found["front"]] == [0.0, 0.5, 1.0]
    assert swims["E_swim"] == pytest.approx(found["only"]["E_swim"], rel=0.01)
    assert climbs["E_climb"] == pytest.approx(found["only"]["E_climb"], rel=0.01)
    for name, value in found["alone"].items():
        assert value <= found["only"][name]
    assert found["dominated_by_a_neighbour"] == []
    for x in found["front"]:
        shares = [x[name] / found["only"][name] for name in ("E_swim", "E_climb")]
        assert x["eta"] == pytest.approx(x["beta"] * shares[0] + (1.0 - x["beta"]) * shares[1])
        for name, (low, high) in found["settings"]["bounds"].items():
            assert low <= x[name] <= high
    assert found["front"][1]["eta"] >= max(
        0.5 * x["E_swim"] / found["only"]["E_swim"] + 0.5 * x["E_climb"] / found["only"]["E_climb"]
        for x in (climbs, swims)
    )
    assert (sought / "multimodal.png").stat().st_size > 10_000


@pytest.mark.slow
def test_the_designs_are_written_as_experiments(sought):
    for name, x in zip(BETAS, told(sought)["front"], strict=True):
        swims, climbs = (load(sought / f"beta_{name}_{task}.toml") for task in ("swim", "climb"))
        assert swims.robot == climbs.robot
        assert swims.robot.tail_length == pytest.approx(x["tail_length"])
        assert swims.trials[0].frequency == pytest.approx(x["frequency"])
        rear = climbs.trials[0].amplitude * climbs.trials[0].rear_ratio
        assert rear == pytest.approx(x["climb_rear"])


@pytest.mark.slow
def test_a_search_that_was_stopped_goes_on(sought, tmp_path, monkeypatch):
    """Stopped in the middle of its fourth search; the front is the same."""
    from slider_jax import optimise

    saved, kept = [], optimise._save

    def stop(*given):
        kept(*given)
        saved.append(given[0])
        if len(saved) == 6:
            raise KeyboardInterrupt

    monkeypatch.setattr(optimise, "_save", stop)
    assert optimize(tmp_path) == 130
    assert not (tmp_path / "out" / "multimodal.json").exists()
    assert optimize(tmp_path) == 2
    assert optimize(tmp_path, "--resume") == 0
    assert told(tmp_path / "out")["front"] == told(sought)["front"]


def test_a_task_without_weight_may_fail():
    efficiencies = np.array([[0.2, np.nan], [0.1, 0.6]])
    only = np.array([0.2, 0.6])
    np.testing.assert_allclose(eta(1.0, efficiencies, only), [1.0, 0.5])
    np.testing.assert_allclose(eta(0.25, efficiencies, only), [np.nan, 0.875])


def test_a_dominated_point_is_told():
    def at(beta, *both):
        return Point(beta, 0.0, np.array(both), np.zeros(11))

    good = [at(0.0, 0.1, 0.9), at(0.5, 0.2, 0.8), at(1.0, 0.3, 0.1)]
    assert dominated(good) == []
    assert dominated([*good[:2], at(1.0, 0.15, 0.8)]) == [1.0]


@pytest.mark.slow
def test_one_steady_stride_stands_for_fifty():
    """Of the work and the thrust of swimming."""
    model, f = swimmer(to_model(coarse())), jnp.asarray(5.0)
    modes = Modes.of(coarse(), steps_per_stride=48)
    search = modes.task.search

    @jax.jit
    def both(model):
        carry = find_steady(model, f, search).carry
        now = performance(model, f, next_stride(model, f, carry, search), search)
        later, _ = strides(model, f, carry, 48, search)
        return now, performance(model, f, next_stride(model, f, later, search), search)

    now, later = both(model)
    for name in ("speed", "power", "thrust", "froude_efficiency"):
        assert getattr(later, name) == pytest.approx(float(getattr(now, name)), rel=2e-3), name


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--betas", "1"], "--betas: given 1; allowed 2 or more"),
        (["--population", "1"], "--population: given 1; allowed 4 or more members"),
        (["--tail-length", "0.1", "0.05"], "--tail-length: given 0.1 0.05; allowed LOW HIGH"),
        (["--EI-tail", "1", "5e6"], "--EI-tail: given 5e+06; allowed 1e-06 to 100 N m^2"),
    ],
)
def test_bad_options_are_told(words, said, tmp_path, capsys):
    assert optimize(tmp_path, *words) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
