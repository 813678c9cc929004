"""The script that writes a synthetic tank with an undeclared effect."""

import json
import runpy

import numpy as np
import pytest

from calibration.measurements.records import load_records
from slider_jax.errors import InputError
from slider_jax.experiment.load import load
from tests.support.data import ROOT

SCRIPT = ROOT / "scripts" / "make_tank.py"
main = runpy.run_path(str(SCRIPT))["main"]


@pytest.mark.slow
def test_the_effect_is_in_the_data_and_not_in_the_file(tmp_path):
    options = ["--effect", "valve_delay.delay=0.02", "--trials", "1", "--seconds", "0.1"]
    assert main([str(tmp_path), *options]) == 0
    tank = load(tmp_path / "experiment.toml")
    assert not tank.effects
    (found,) = load_records(tank)
    before, after = found.t < 0.02, (found.t > 0.03) & (found.t < 0.1)
    assert np.abs(found.values[0][before]).max() < 4000.0
    assert np.abs(found.values[0][after]).min() > 10000.0
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert truth["effects"] == {"valve_delay": {"delay": 0.02}}
    assert set(truth["parameters"]) == {"C_d", "m_a", "k", "K_Q"}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("no_such.x=1", "unknown effect no_such"),
        ("valve_delay.x=1", "allowed parameters are delay"),
        ("valve_delay.delay=soon", "EFFECT.PARAMETER=NUMBER"),
        ("valve_delay.delay=20", "allowed 0 to 0.06 s"),
    ],
)
def test_an_invalid_effect_is_refused(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        main([str(tmp_path / "x"), "--effect", text])
    assert not (tmp_path / "x").exists()
