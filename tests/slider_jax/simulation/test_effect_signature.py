"""`slider effects`: the list, one effect explained, its picture, and bad input."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from slider_jax.cli.effects import place_of
from slider_jax.cli.main import main
from slider_jax.effects.check import PLACES
from slider_jax.effects.library import LIBRARY
from slider_jax.errors import SolverError
from slider_jax.experiment.load import load
from slider_jax.experiment.prepare import StepGrid
from slider_jax.simulation import effect_signature as signatures
from slider_jax.simulation.effect_signature import (
    built_in_experiment,
    effect_signature,
    typical_size,
)
from tests.support.experiments import write_small_experiment


def said(capsys, *words):
    assert main(["effects", *map(str, words)]) == 0
    return capsys.readouterr().out


def test_the_list_has_every_effect_once_with_its_parameters_under_its_place(capsys):
    text = said(capsys)
    blocks = text.split("\n\n")[1:]
    assert 0 < len(blocks) <= len(PLACES)
    for name, kind in LIBRARY.items():
        (block,) = (x for x in blocks if re.search(rf"^  {name} ", x, re.MULTILINE))
        assert block.splitlines()[0] == place_of(kind).__doc__.splitlines()[0].rstrip(".")
        assert f"{kind.title} ({', '.join(kind.sensors)})" in block
        own = re.split(r"\n  (?=\S)", block.split(f"\n  {name} ")[1])[0].splitlines()
        for parameter, prior in kind.priors().items():
            (line,) = (x for x in own if x.strip().startswith(f"{parameter}: "))
            assert f"{prior.low:g} to {prior.high:g}" in line
            assert prior.unit in line or prior.unit == "-"


def test_no_line_of_the_list_is_too_long_for_a_screen(capsys):
    assert max(map(len, said(capsys).splitlines())) <= 120


def test_one_effect_is_explained_with_equation_source_priors_and_table(capsys):
    text = said(capsys, "valve_delay")
    for part in (
        "dead time of the valves",
        "p_set,valve(t) = p_set(t - delay)",
        "Source: ",
        "0 to 0.06 s",
        LIBRARY["valve_delay"].priors()["delay"].why,
        '[[effects]]\n  name = "valve_delay"\n  delay = 0.03',
    ):
        assert part in text


def test_shape_parameters_and_segments_are_listed_apart_from_the_priors(capsys):
    text = said(capsys, "stress_relaxation")
    parameters, shapes = text.split("\nparameters\n")[1].split("\nshape parameters ")
    assert "E_1" in parameters and "tau" not in parameters
    assert "  tau  0.02 to 2 s, default 0.1  half of a stride" in shapes
    assert "acts on: body\n" in text
    plain = said(capsys, "valve_delay")
    assert "shape parameters" not in plain and "acts on" not in plain


@pytest.mark.parametrize("name", LIBRARY)
def test_every_effect_can_be_explained_and_added_as_it_says(name, capsys, tmp_path):
    table = said(capsys, name).split("example for an experiment or model file\n")[1]
    load(write_small_experiment(tmp_path, ("[sensors]", f"{table}\n[sensors]")))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ("valve_dely",),
            "NAME: given 'valve_dely'; allowed are the names of `slider effects`; "
            "did you mean valve_delay?",
        ),
        (("--out", "x"), "--out: needs the NAME of an effect; add this NAME"),
        (
            ("valve_delay", "--experiment", "x"),
            "--experiment: needs a folder for the figure; add --out",
        ),
        (("valve_delay", "--out", "y", "--experiment", "x"), "x: no such file"),
        (("valve_delay", "--outt", "y"), "--outt: unknown option"),
    ],
)
def test_bad_input_is_refused_in_one_line(words, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["effects", *words]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def gain(tmp_path_factory):
    """Returns the signature of a force sensor's gain in the first trial of the small experiment."""
    experiment = load(write_small_experiment(tmp_path_factory.mktemp("signature")))
    return effect_signature(experiment, "force_gain")


@pytest.mark.slow
def test_the_signature_of_a_gain_is_that_share_of_the_forces(gain):
    (trace,) = gain.traces
    assert (trace.label, trace.size) == ("gain = 0.15", 0.15)
    change = gain.change(trace)
    for name in ("thrust_N", "recoil_N"):
        np.testing.assert_allclose(change[name], 0.15 * gain.without[name], atol=1e-9)
        assert np.abs(gain.without[name]).max() > 0.1
    for name in ("p_front_Pa", "p_rear_Pa", "tip_m"):
        assert not change[name].any() and gain.rms(trace)[name] == 0.0


def test_the_signature_is_of_one_whole_steady_stride(gain):
    """Of a trial of 3 strides made longer: the front chamber switches at phase 0 and a half."""
    assert gain.phase[0] == 0.0 and gain.phase[-1] == pytest.approx(1.0)
    assert gain.run.t[-1] >= signatures.STRIDES / 4.0 - 1e-9
    for series in gain.without.values():
        assert series[-1] == pytest.approx(series[0], abs=0.01 * np.ptp(series))
    front = gain.without["p_front_Pa"]
    assert gain.phase[np.argmax(front)] == pytest.approx(0.5)


def test_without_a_frequency_the_last_second_is_shown():
    for steps, first in ((700, 450), (100, 0)):
        run = SimpleNamespace(grid=StepGrid(0.004, steps))
        assert signatures._last_stride(run) == slice(first, steps + 1)


def test_a_size_that_cannot_be_simulated_is_halved():
    tried = []

    def run(gain):
        tried.append(gain)
        if abs(gain) > 0.05:
            raise SolverError("too much")
        return "run"

    prior = LIBRARY["force_gain"].priors()["gain"]
    assert signatures._largest(run, "gain", prior) == (0.0375, "run")
    assert tried == [0.15, 0.075, 0.0375]
    with pytest.raises(SolverError):
        signatures._largest(lambda gain: run(1.0), "gain", prior)


def test_the_typical_size_is_the_far_end_of_the_range():
    prior = LIBRARY["force_gain"].priors()["gain"]
    assert typical_size(prior) == prior.high
    assert typical_size(prior._replace(null=prior.high)) == prior.low


@pytest.mark.draws
def test_the_command_draws_the_picture_and_says_how_large_the_change_is(gain, capsys, tmp_path):
    out = tmp_path / "out"
    text = said(
        capsys, "force_gain", "--out", out, "--experiment", write_small_experiment(tmp_path)
    )
    rms = gain.rms(gain.traces[0])
    line = f"gain = 0.15: thrust {1e3 * rms['thrust_N']:.4g} mN; recoil {1e3 * rms['recoil_N']:.4g}"
    assert line in text
    assert [p.name for p in out.iterdir()] == ["force_gain.png"]
    with Image.open(out / "force_gain.png") as picture:
        assert picture.size == (1650, 1500)
        assert len(set(picture.convert("L").tobytes())) > 50


def test_the_built_in_robot_is_a_valid_experiment():
    experiment = built_in_experiment()
    assert experiment.trials[0].frequency == signatures.FREQUENCY
    assert experiment.trials[0].duration == pytest.approx(signatures.STRIDES / signatures.FREQUENCY)
