"""Instruments: what each makes of a known series, against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.beam.state import to_body
from slider_jax.channels import SLIDER_CHANNELS
from slider_jax.effects.sensors.camera_delay import CameraDelay
from slider_jax.effects.sensors.camera_offset import CameraOffset
from slider_jax.effects.sensors.camera_scale import CameraScale
from slider_jax.effects.sensors.force_clock_offset import ForceClockOffset
from slider_jax.effects.sensors.force_crosstalk import ForceCrosstalk
from slider_jax.effects.sensors.force_cubic import ForceCubic
from slider_jax.effects.sensors.force_drift import ForceDrift
from slider_jax.effects.sensors.force_gain import ForceGain
from slider_jax.effects.sensors.force_gain_mismatch import ForceGainMismatch
from slider_jax.effects.sensors.force_resonance import ForceResonance
from slider_jax.effects.sensors.force_sensor_lag import ForceSensorLag
from slider_jax.effects.sensors.force_side_gain import ForceSideGain
from slider_jax.effects.sensors.force_warm_up import ForceWarmUp
from slider_jax.effects.sensors.lens_distortion import LensDistortion
from slider_jax.effects.sensors.mains_hum import MainsHum
from slider_jax.effects.sensors.pressure_drift import PressureDrift
from slider_jax.effects.sensors.pressure_gain import PressureGain
from slider_jax.effects.sensors.pressure_offset import PressureOffset
from slider_jax.effects.sensors.pressure_resonance import PressureResonance
from slider_jax.effects.sensors.pressure_saturation import PressureSaturation
from slider_jax.effects.sensors.pressure_sensor_lag import PressureSensorLag
from tests.support.helpers import order, reading, slider_readings

TURN = 2.0 * np.pi


def made_of(value, t):
    """Readings whose channels are value(t) times a factor for each channel."""
    shape = value(t)
    return slider_readings(t, 2e5 * shape, -1e5 * shape, 0.3 * shape, 0.8 * shape, 0.02 * shape)


def untouched(effect, true, read):
    """Checks that t and the other channels are bitwise unchanged."""
    seen = ("p_front", "p_rear") if "pressure" in effect.sensors else ()
    for name in ("t", *SLIDER_CHANNELS):
        if name not in (*seen, *effect.sensors):
            np.testing.assert_array_equal(reading(read, name), reading(true, name))


def phasor(t, x, f):
    """Complex amplitude of exp(2 pi i f t) in the last five periods of a series."""
    last = t > t[-1] - 5.0 / f + 0.5 * (t[1] - t[0])
    return 2.0 * np.mean(np.asarray(x)[last] * np.exp(-1j * TURN * f * np.asarray(t)[last]))


SERIES = made_of(lambda t: np.sin(9.0 * t) + 0.3 * np.cos(31.0 * t), np.linspace(0.0, 1.0, 401))


@pytest.mark.parametrize(
    ("effect", "expected"),
    [
        (ForceGain(0.1), {"thrust": 1.1, "recoil": 1.1}),
        (ForceGainMismatch(0.1), {"thrust": 1.1, "recoil": 0.9}),
        (CameraScale(-0.05), {"tip": 0.95}),
        (PressureGain(0.02), {"p_front": 1.02, "p_rear": 1.02}),
    ],
)
def test_a_gain_scales_only_its_own_channels(effect, expected):
    read = effect.read(SERIES)
    for name, factor in expected.items():
        np.testing.assert_allclose(reading(read, name), factor * reading(SERIES, name), rtol=1e-14)
    untouched(effect, SERIES, read)


def test_an_offset_shifts_both_pressures():
    read = PressureOffset(3e3).read(SERIES)
    for name in ("p_front", "p_rear"):
        np.testing.assert_allclose(
            np.asarray(reading(read, name) - reading(SERIES, name)), 3e3, rtol=1e-9
        )
    untouched(PressureOffset, SERIES, read)


@pytest.mark.parametrize(
    ("effect", "expected"),
    [
        (ForceDrift(0.02, -0.01), {"thrust": lambda t: 0.02 * t, "recoil": lambda t: -0.01 * t}),
        (
            ForceWarmUp(0.1, -0.05, tau=0.2),
            {
                "thrust": lambda t: 0.1 * (1.0 - np.exp(-t / 0.2)),
                "recoil": lambda t: -0.05 * (1.0 - np.exp(-t / 0.2)),
            },
        ),
        (PressureDrift(1e3), {"p_front": lambda t: 1e3 * t, "p_rear": lambda t: 1e3 * t}),
        (CameraOffset(-4e-3), {"tip": lambda t: -4e-3 + 0.0 * t}),
    ],
    ids=lambda x: x.name() if hasattr(x, "name") else "",
)
def test_a_zero_error_adds_a_function_of_time_to_its_own_channels(effect, expected):
    read, t = effect.read(SERIES), np.asarray(SERIES.t)
    for name, error in expected.items():
        added = np.asarray(reading(read, name) - reading(SERIES, name))
        np.testing.assert_allclose(added, error(t), rtol=1e-9, atol=1e-10)
    untouched(effect, SERIES, read)


def test_a_side_gain_scales_positive_and_negative_forces_differently():
    effect = ForceSideGain(0.05)
    read = effect.read(SERIES)
    for name in ("thrust", "recoil"):
        true = np.asarray(reading(SERIES, name))
        expected = np.where(true > 0.0, 1.05 * true, 0.95 * true)
        np.testing.assert_allclose(reading(read, name), expected, rtol=1e-14)
    untouched(effect, SERIES, read)


@pytest.mark.parametrize(
    ("effect", "c"), [(ForceCubic(0.08), 0.08), (LensDistortion(-12.0), -12.0)]
)
def test_a_cubic_error_has_the_harmonics_of_a_cubed_sine(effect, c):
    """sin^3 = 3/4 sin - 1/4 sin 3: the fundamental gains 3/4 c A^2, the third harmonic c A^3/4."""
    f, t = 5.0, jnp.linspace(0.0, 1.0, 1001)
    true = made_of(lambda t: jnp.sin(TURN * f * t), t)
    read = effect.read(true)
    for name in effect.sensors:
        A = float(np.abs(reading(true, name)).max())
        x = np.asarray(reading(read, name))[1:]
        first, third = (
            2.0 * np.mean(x * np.exp(-1j * TURN * n * f * np.asarray(t)[1:])) for n in (1, 3)
        )
        assert abs(first - -1j * A * (1.0 + 0.75 * c * A**2)) < 1e-9 * A
        assert abs(third - 1j * c * A**3 / 4.0) < 1e-9 * A
    untouched(effect, true, read)


@pytest.mark.parametrize(("c", "beyond"), [(1.0, 0.0), (0.25, 0.75)])
def test_a_pressure_sensor_loses_sensitivity_beyond_its_range(c, beyond):
    """The corner is at 60 kPa, and 5 kPa wide. The pressures are up to 200 and 100 kPa."""
    true = made_of(lambda t: t, jnp.linspace(-1.0, 1.0, 201))
    read = PressureSaturation(c, 60e3).read(true)
    for name in ("p_front", "p_rear"):
        p, found = (np.asarray(reading(x, name)) for x in (true, read))
        inside = np.clip(p, -60e3, 60e3)
        expected = inside + beyond * (p - inside)
        far = np.abs(np.abs(p) - 60e3) > 25e3
        assert (np.abs(p[far]) > 60e3).any()
        np.testing.assert_allclose(found[far], expected[far], atol=c * 250.0)
        corner = np.argmin(np.abs(p - 60e3))
        assert abs(found[corner] - (60e3 - c * 2.5e3)) < 100.0
    untouched(PressureSaturation, true, read)


def test_hum_has_the_amplitude_and_phase_of_its_sine_and_cosine():
    t = jnp.linspace(0.0, 1.0, 4801)
    true = made_of(lambda t: 0.0 * t, t)
    read = MainsHum(a=0.03, b=-0.02, frequency=60.0).read(true)
    for name in ("thrust", "recoil"):
        for f, expected in ((60.0, -0.02 - 0.03j), (50.0, 0.0)):
            assert abs(phasor(t, reading(read, name), f) - expected) < 1e-9
    untouched(MainsHum, true, read)


def test_a_rotated_sensor_reads_the_components_along_its_own_axes():
    read = ForceCrosstalk(0.3).read(SERIES)
    along, across = to_body((SERIES.thrust, SERIES.recoil), 0.3)
    np.testing.assert_allclose(read.thrust, along, rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(read.recoil, across, rtol=1e-13, atol=1e-15)
    untouched(ForceCrosstalk, SERIES, read)


@pytest.mark.parametrize(
    ("effect", "names"),
    [
        (ForceSensorLag(0.02), ("thrust", "recoil")),
        (PressureSensorLag(0.02), ("p_front", "p_rear")),
    ],
)
def test_a_lag_follows_a_ramp_exactly(effect, names):
    t = jnp.linspace(0.0, 0.3, 61)
    true = made_of(lambda t: 5.0 + 2.0 * t, t)
    read = effect.read(true)
    behind = 2.0 * 0.02 * -np.expm1(-np.asarray(t) / 0.02)
    for name in names:
        size = reading(true, name)[0] / 5.0
        expected = np.asarray(reading(true, name) - size * behind)
        np.testing.assert_allclose(reading(read, name), expected, rtol=1e-13)
    untouched(effect, true, read)


@pytest.mark.parametrize("kind", [ForceSensorLag, PressureSensorLag])
def test_the_tangent_of_a_lag_at_its_null_is_the_slope(kind):
    t = jnp.linspace(0.0, 1.0, 2001)
    true = made_of(lambda t: jnp.sin(7.0 * t), t)
    read, tangent = jax.jvp(lambda tau: kind(tau).read(true), (0.0,), (1.0,))
    for name in SLIDER_CHANNELS:
        np.testing.assert_array_equal(reading(read, name), reading(true, name))
    name = "thrust" if kind is ForceSensorLag else "p_rear"
    size = reading(true, name)[1] / jnp.sin(7.0 * t[1])
    slope = np.asarray(-7.0 * size * jnp.cos(7.0 * t))[1:]
    assert np.abs(reading(tangent, name)[1:] - slope).max() < 3e-3 * np.abs(slope).max()


@pytest.mark.parametrize("kind", [ForceResonance, PressureResonance])
def test_a_resonance_has_the_response_of_its_oscillator(kind):
    """At half, at and beyond its natural frequency; second order in the step."""
    natural, b = 12.0, 15.0
    c = 1.0 / (TURN * natural) ** 2
    effect = kind(c, b)
    names = ("thrust", "recoil") if kind is ForceResonance else ("p_front", "p_rear")

    def off(f, dt):
        t = dt * jnp.arange(round(2.0 / dt) + 1.0)
        true = made_of(lambda t: jnp.sin(TURN * f * t), t)
        read = effect.read(true)
        untouched(effect, true, read)
        w = TURN * f
        expected = 1.0 / (1.0 - c * w**2 + 1j * c * b * w)
        ratios = [phasor(t, reading(read, n), f) / phasor(t, reading(true, n), f) for n in names]
        np.testing.assert_allclose(ratios[0], ratios[1], rtol=1e-12)
        return abs(ratios[0] / expected - 1.0)

    for f in (5.0, 10.0, 20.0):
        errors = [off(f, dt) for dt in (1e-3, 0.5e-3)]
        assert errors[1] < 0.01
        assert order((2.0, 1.0), errors) == pytest.approx(2.0, abs=0.25)


def test_a_resonance_rings_at_its_frequency_and_settles():
    c = 1.0 / (TURN * 16.0) ** 2
    t = 2e-4 * jnp.arange(5001.0)
    true = made_of(lambda t: jnp.where(t > 0.1, 1.0, 0.0), t)
    thrust = np.asarray(ForceResonance(c).read(true).thrust) / 0.3
    ups = np.flatnonzero((thrust[:-1] < 1.0) & (thrust[1:] >= 1.0))[:6]
    damped = 16.0 * np.sqrt(1.0 - (20.0 * np.sqrt(c) / 2.0) ** 2)
    assert np.diff(t[ups]).mean() == pytest.approx(1.0 / damped, rel=5e-3)
    peak = 1.0 + np.exp(-np.pi * 0.5 * 20.0 / (TURN * damped))
    assert thrust.max() == pytest.approx(peak, rel=0.02)
    assert abs(thrust[-1] - 1.0) < 1e-3


def test_a_resonance_beyond_the_samples_follows_the_force():
    t = jnp.linspace(0.0, 1.0, 101)
    true = made_of(lambda t: jnp.sin(6.0 * t), t)
    read = ForceResonance(1e-9).read(true)
    np.testing.assert_allclose(read.recoil, true.recoil, atol=1e-5)
    kick = made_of(lambda t: jnp.where(t > 0.5, 1.0, 0.0), t)
    for c in (1e-7, 1e-5, 1e-3):
        assert np.abs(ForceResonance(c).read(kick).recoil).max() < 2.0 * 0.8


@pytest.mark.parametrize(
    ("kind", "names"), [(ForceClockOffset, ("thrust", "recoil")), (CameraDelay, ("tip",))]
)
def test_a_delay_moves_the_curve(kind, names):
    t = jnp.linspace(0.0, 1.0, 401)

    def value(t):
        return jnp.sin(9.0 * t) + 0.3 * jnp.cos(31.0 * t)

    true = made_of(value, t)
    for delay in (0.01, 0.0137, -0.0137):
        read, moved = kind(delay).read(true), made_of(value, t - delay)
        inside = (t > 0.02) & (t < 0.98)
        for name in names:
            size = np.abs(reading(true, name)).max()
            assert np.abs(reading(read, name) - reading(moved, name))[inside].max() < 1e-4 * size
        untouched(kind, true, read)
    read = kind(0.01).read(true)  # four samples: exact, and what was there at the start before them
    for name in names:
        before, after = np.asarray(reading(true, name)), np.asarray(reading(read, name))
        np.testing.assert_allclose(after[4:], before[:-4], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(after[:4], before[0], rtol=1e-9)


@pytest.mark.parametrize(
    "kind", [ForceClockOffset, pytest.param(CameraDelay, marks=pytest.mark.slow)]
)
def test_the_tangent_of_a_delay_at_its_null_is_the_slope_of_either_side(kind):
    t = jnp.linspace(0.0, 1.0, 401)
    true = made_of(lambda t: jnp.sin(9.0 * t), t)
    name = kind.sensors[0]

    def read(delay):
        return getattr(kind(delay).read(true), name)

    value, tangent = jax.jvp(read, (0.0,), (1.0,))
    np.testing.assert_array_equal(value, reading(true, name))
    size = np.abs(tangent).max()
    slope = -reading(true, name)[1] / jnp.sin(9.0 * t[1]) * 9.0 * jnp.cos(9.0 * t)
    assert np.abs(tangent - slope)[1:-1].max() < 1e-3 * size
    for step in (1e-6, -1e-6):
        np.testing.assert_allclose((read(step) - value) / step, tangent, atol=1e-3 * size)
