"""Definitions of a wavelength, on waves that are known."""

import numpy as np
import pytest

from slider_jax.reproduction.wavelengths import wavelengths, without_recoil, zeros_wavelength
from slider_jax.swimming.paper_optimum import PUBLISHED
from slider_jax.swimming.performance import Stride

F, STEPS, A, LAMBDA = 4.0, 60, 0.004, 0.2
S = np.linspace(0.0, 0.4, 161)  # two waves
T = np.arange(1.0, STEPS + 1.0) / (STEPS * F)


def made(standing=0.0, turned=0.0):
    """Returns a stride of a small wave towards the tail, on a course at an angle `turned` [rad]."""
    phase, k = 2 * np.pi * F * T[:, None], 2 * np.pi / LAMBDA
    y = 0.05 + A * (np.sin(phase + k * S) + standing * np.sin(phase - k * S)) / (1.0 + standing)
    x = S + 0.3 * T[:, None]
    c, s = np.cos(turned), np.sin(turned)
    midline = np.stack([c * x - s * y, s * x + c * y], axis=1)
    ahead = np.array([c, s])
    velocity = np.tile(0.3 * ahead, (STEPS, 1))
    none = np.zeros(STEPS)
    return Stride(T, midline, velocity, none, none, velocity[0], ahead, np.array(True))


@pytest.mark.slow
def test_every_definition_gives_the_length_of_a_travelling_wave():
    found = wavelengths(made(turned=0.7), S, F)
    for name, wavelength in found.items():
        print(f"{name}: {1e3 * wavelength:.1f} mm")
        assert wavelength == pytest.approx(LAMBDA, rel=0.03), name


@pytest.mark.slow
@pytest.mark.parametrize("standing", [0.5, 1.0])
def test_definitions_by_shape_also_give_the_length_of_a_standing_wave(standing):
    found = wavelengths(made(standing), S, F)
    assert found["shape"] == pytest.approx(LAMBDA, rel=5e-3)
    assert found["zeros"] == pytest.approx(LAMBDA, rel=0.01)


def test_the_papers_two_tail_slopes_differ_as_a_sine_and_its_rms_slope():
    """A sine with A_t/(lambda/4) = 0.51 has a root mean square slope of 0.57."""
    own, stated = PUBLISHED["shape_tail_slope"].model, PUBLISHED["tail_slope"].model
    assert own * np.pi / np.sqrt(8) == pytest.approx(stated, abs=0.005)


def test_recoil_is_a_straight_line_and_a_shape_may_have_no_zeros():
    line = np.outer(np.sin(7.0 * T), 1.0 + 2.0 * S)
    np.testing.assert_allclose(without_recoil(line, S), 0.0, atol=1e-14)
    assert np.isnan(zeros_wavelength(1.0 + 0.0 * line, S))
