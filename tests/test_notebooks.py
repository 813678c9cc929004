"""Every notebook runs from beginning to end, as a new user runs it."""

import runpy

import jax
import matplotlib.pyplot as plt
import numpy as np
import pytest

from tests.support.data import ROOT

NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.py"))


def one_stride(found):
    """The printed numbers agree with the text."""
    mean = found["last"]["thrust"].mean()
    assert found["from_water"] == pytest.approx(mean, rel=0.01)
    assert found["obs"].travelling_index(found["mode"]) < 0.2
    reached = np.abs(found["last"]["pressure"]).max()
    assert 0.5 * 260e3 < reached < 0.6 * 260e3
    F_tau, F_n = np.moveaxis(found["last"]["reactive"], 1, 0)
    assert np.abs(F_tau).max() < 1e-4 * np.abs(F_n).max()


def tracing_the_valve(found):
    """The loop names the valves and removes most of the residual on held-out logs."""
    assert found["outcome"].search.effects[0] == "firmware_valves"
    assert found["outcome"].verdict == "identified"
    assert found["after"] < 0.15 * found["before"]


def calibrating_drag_and_added_mass(found):
    """The intervals contain the true coefficients; those from thrust alone are wider."""
    for i, label in enumerate(found["labels"]):
        _, low, high = found["confidence_interval"](found["found"].fit, found["found"].entries, i)
        assert low < found["truth"][label] < high, label
    assert all(x > 1.2 for x in found["wider"].values())
    assert np.abs(found["measured"] - found["predicted"]).max() < 0.05


def designing_a_tail(found):
    """Maps, gradient and genetic algorithm agree on the fastest tail."""
    on_map, climbed = 100 * np.nanmax(found["on_grid"]), 100 * np.nanmax(found["heights"])
    assert climbed > 0.97 * on_map and 100 * found["bred"].score > 0.97 * on_map
    assert climbed > 1.5 * 100 * found["heights"][0]
    assert 100 * found["finer"] == pytest.approx(climbed, rel=0.15)


def from_the_rig_to_a_fit(found):
    """No reading is lost, and the fit finds the coefficients of the tank."""
    assert all(x["readings_lost"] == 0 for x in found["summaries"])
    assert abs(found["clock"].rate - 1.0) < 2e-4
    for i, entry in enumerate(found["fitted"].entries):
        # On a busy computer the simulated rig is late, and the intervals miss the true values.
        value, _, _ = found["confidence_interval"](found["fitted"].fit, found["fitted"].entries, i)
        assert abs(value / found["truth"][entry.label] - 1.0) < 0.15, entry.label


CLAIMS = {
    "from_the_rig_to_a_fit": from_the_rig_to_a_fit,
    "designing_a_tail": designing_a_tail,
    "one_stride": one_stride,
    "tracing_the_valve": tracing_the_valve,
    "calibrating_drag_and_added_mass": calibrating_drag_and_added_mass,
}


def test_there_are_notebooks():
    assert NOTEBOOKS


LONG = (
    "calibrating_drag_and_added_mass",
    "designing_a_tail",
    "from_the_rig_to_a_fit",
    "tracing_the_valve",
)


@pytest.mark.parametrize(
    "notebook",
    [pytest.param(n, marks=[pytest.mark.slow] * (n.stem in LONG), id=n.stem) for n in NOTEBOOKS],
)
@pytest.mark.slow
def test_notebook_runs_and_draws(notebook, monkeypatch, tmp_path):
    drawn = []

    def show():
        for number in plt.get_fignums():
            figure = plt.figure(number)
            assert figure.axes, "an empty figure"
            labels = [(ax.get_xlabel(), ax.get_ylabel()) for ax in figure.axes]
            assert all(map(any, zip(*labels, strict=True))), "an axis has no label"
            path = tmp_path / f"{len(drawn)}.png"
            figure.savefig(path, dpi=40)
            drawn.append(path)
        plt.close("all")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SLIDER_DATA", str(tmp_path / "none"))
    monkeypatch.delenv("SLIDER_EXPERIMENT", raising=False)
    monkeypatch.setattr(plt, "show", show)
    # A newcomer's JAX mixes types; the tests' does not, and optax's schedules need it to.
    with jax.numpy_dtype_promotion("standard"):
        found = runpy.run_path(str(notebook), run_name="__main__")
    assert drawn
    assert not plt.get_fignums(), "a figure is never shown"
    CLAIMS[notebook.stem](found)
