"""Designs: their box, their models, their files."""

import itertools
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.errors import InputError
from slider_jax.experiment.load import assemble, load, to_model
from slider_jax.optimise.design_space import VARIABLES, gait_bounds, models, to_toml, with_gait
from slider_jax.swimming.gait import Gait, to_swimmer
from slider_jax.swimming.paper_optimum import PAPER_GAIT, optimum, swimmer_content

GAIT = Gait(2.3, 300e3, 240e3, -0.1, 0.061, 0.009)


def with_effects():
    from dataclasses import fields

    from slider_jax.effects.library import LIBRARY

    (name, first) = next(
        (name, next(iter(kind.priors())))
        for name, kind in LIBRARY.items()
        if "stride_frequency" in {f.name for f in fields(kind)}
    )
    content = swimmer_content(frequency=5.0, amplitude=3e5)
    content["effects"].append({"name": name, first: 0.1})
    return assemble(content, "test", Path("."))


@pytest.mark.parametrize("coefficients", ["ramp", "table", "fixed"])
def test_the_model_of_a_gait_is_that_of_an_experiment_with_it(coefficients):
    experiment = with_effects()
    parameters = {"force_coefficients": coefficients, "k": 0.08, "K_Q": 4.5e-7}
    if coefficients == "fixed":
        parameters |= {"C_d": 2.9, "m_a": 0.8}
    if coefficients == "table":
        at = ((1.0, 4.0, 0.2), (4.0, 2.5, 0.9))
        parameters["coefficients"] = [
            {"frequency": f, "C_d": C_d, "m_a": m_a} for f, C_d, m_a in at
        ]
    content = experiment.model_dump() | {"parameters": parameters}
    experiment = assemble(content, "test", Path("."))
    made = models(experiment)(Gait(*(jnp.asarray(x) for x in GAIT)))
    expected = to_swimmer(to_model(with_gait(experiment, GAIT)))
    assert jax.tree.structure(made) == jax.tree.structure(expected)
    for a, b in zip(jax.tree.leaves(made), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9)
    C_d = jax.grad(lambda f: models(experiment)(GAIT._replace(frequency=f)).effects[0].C_d)(2.3)
    assert (float(C_d) == 0.0) == (coefficients == "fixed")


def test_a_design_is_written_as_an_experiment_that_is_read_back(tmp_path):
    (tmp_path / "best.toml").write_text(to_toml(with_gait(optimum(), GAIT), "two\nlines"))
    again = load(tmp_path / "best.toml")
    assert again.model_dump() == with_gait(optimum(), GAIT).model_dump()
    assert again.robot.EI_tail == GAIT.EI_tail and again.trials[0].frequency == GAIT.frequency
    np.testing.assert_allclose(
        again.trials[0].amplitude * again.trials[0].rear_ratio, GAIT.rear, rtol=1e-12
    )


def test_every_corner_of_the_box_can_be_written_and_read(tmp_path):
    content = swimmer_content(frequency=5.0, amplitude=3e5, initial={"angle": 0.1})
    content |= {"name": "\u2603 \U0001f41f", "numerics": {"step": 0.01}}
    experiment, box = assemble(content, "test", Path(".")), gait_bounds({})
    for bits in itertools.product((0.0, 1.0), repeat=6):
        found = with_gait(experiment, Gait(*box.gait(np.array(bits))))
        (tmp_path / "best.toml").write_text(to_toml(found))
        assert load(tmp_path / "best.toml").model_dump() == found.model_dump()


def test_the_papers_gait_is_in_the_box():
    box = gait_bounds({})
    unit = box.unit(PAPER_GAIT)
    assert np.all((unit >= 0.0) & (unit <= 1.0))
    np.testing.assert_allclose(box.gait(unit), PAPER_GAIT)
    assert tuple(VARIABLES) == Gait._fields


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"frequency": (5.0, 3.0)}, "--frequency: given 5 3; allowed LOW HIGH with LOW < HIGH"),
        ({"front": (4e5, 4e5)}, "--front: given 400000 400000; allowed LOW HIGH"),
        ({"EI_tail": (-1.0, 0.01)}, "--EI-tail: given -1; allowed"),
        ({"tail_length": (0.02, 40.0)}, "--tail-length: given 40; allowed"),
        ({"rear": (float("nan"), 4e5)}, "--rear: given nan"),
    ],
)
def test_bounds_that_cannot_be_are_refused(given, said):
    with pytest.raises(InputError) as raised:
        gait_bounds(given)
    assert said in str(raised.value)
