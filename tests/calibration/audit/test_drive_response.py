"""The lag of the rear pressure, from a lag's response to square waves."""

import numpy as np
import pytest

from calibration.audit.drive_response import chamber_tones, wrapped
from calibration.measurements.records import Record
from slider_jax.actuation import FirstOrderLag, SquareWave
from slider_jax.channels import SLIDER_CHANNELS
from slider_jax.experiment.schema import Trial
from tests.support.chambers import pressure_history

PHASE, RATIO = 0.3, 0.8


def record(seconds: float) -> Record:
    """Returns the record of a trial at 1 Hz."""
    drive = {"frequency": 1.0, "amplitude": 1e5, "rear_ratio": RATIO, "phase": PHASE}
    trial = Trial.model_validate({"file": "a.csv", "duration": seconds} | drive)
    t = np.arange(0.0, seconds, 0.002)
    p = [
        pressure_history(FirstOrderLag(0.08), wave, 0.0, t)
        for wave in (SquareWave(1.0, 1e5), SquareWave(1.0, RATIO * 1e5, PHASE))
    ]
    return Record(trial, t, np.stack([*p, *np.full((3, len(t)), np.nan)]), SLIDER_CHANNELS)


@pytest.mark.parametrize("seconds", [1.8, 3.0, 6.5])
def test_lag_and_ratio_equal_those_of_the_drives(seconds):
    tones = chamber_tones(record(seconds))
    lag, ratio = tones.lag[1] - tones.lag[0], np.exp(tones.size[0] - tones.size[1])
    print(f"{lag:.3f} of a period, {ratio:.3f}")
    assert abs(wrapped(lag - PHASE)) < 0.03
    assert ratio == pytest.approx(1.0 / RATIO, rel=0.1)


def test_less_than_a_settled_stride_gives_neither_lag_nor_ratio():
    assert chamber_tones(record(1.2)) is None
