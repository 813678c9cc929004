"""Converts midlines to the motion of an inextensible body: angles, velocities and accelerations.

The angle phi(s, t) of the midline is smoothed along the body and in time. The positions r(s, t) of
a body with constant length L are computed from the head, with the unit vector tau along the body:

    dr/ds = tau(phi),     r(L, t) = track of the head

The positions start at the head, because the measured track of the head has little noise.

The smoothing fits a cubic smoothing spline to a series, fits a second spline to the residual, and
adds both splines (twicing). At a frequency or wavenumber f, one spline multiplies amplitudes by
g = 1/(1 + (f/f_1)^4), and twicing by 1 - (1 - g)^2. The parameter f_1 sets the spline's stiffness.
The settings of the smoothing are the values of f at which twicing halves an amplitude.
Sources: Reinsch, C. H. (1967), Smoothing by spline functions, Numer. Math. 10, 177-183; Tukey,
J. W. (1977), Exploratory Data Analysis, ch. 16.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.interpolate import make_smoothing_spline

from calibration.lamprey.midlines import Midlines

NODES = 81
"""Number of evenly spaced nodes of the body."""
WAVELENGTHS = (0.6, 0.5, 0.4, 0.35, 0.3, 0.25, 0.2, 0.15)
"""Wavelengths [body lengths] that `choose_smoothing` tries for the smoothing along the body."""
RESIDUAL_OVER_NOISE = 1.5
"""Largest allowed residual of the smoothing along the body, divided by the noise of the angles."""
FRAME_STRIDE = 4
"""The choice of the wavelength uses only every fourth frame, to save time."""
NOISE_BAND = 0.7
"""Above this fraction of the highest frequency, the angles are assumed to contain only noise."""
POWER_OVER_NOISE = 2.0
"""Power of the angles at the cutoff frequency, divided by the power of the noise."""
_TWICING_RATIO = (1.0 / (1.0 - math.sqrt(0.5)) - 1.0) ** 0.25
"""Cutoff frequency divided by f_1 (see the formula in the module's docstring)."""


class Smoothing(NamedTuple):
    """Settings with which midlines are smoothed."""

    wavelength: float
    """Wavelength along the body [body lengths] at which the smoothing halves an amplitude."""
    cutoff: float
    """Frequency [Hz] at which the smoothing halves an amplitude."""


class Motion(NamedTuple):
    """The motion of a body, with nodes from the tail (s = 0) to the head (s = L)."""

    t: np.ndarray
    """Times (times,) [s]."""
    s: np.ndarray
    """Positions of the nodes along the body (nodes,) [m]."""
    phi: np.ndarray
    """Angle of the body (times, nodes) [rad]."""
    omega: np.ndarray
    """Turning rate d(phi)/dt (times, nodes) [rad/s]."""
    r: np.ndarray
    """Position x and y (times, nodes, 2) [m]."""
    V: np.ndarray
    """Velocity (times, nodes, 2) [m/s]."""
    A: np.ndarray
    """Acceleration (times, nodes, 2) [m/s^2]."""

    @property
    def length(self) -> float:
        """Length L [m] of the body."""
        return float(self.s[-1])


class Angles(NamedTuple):
    """Angles of the segments between measured points."""

    phi: np.ndarray
    """Angle (frames, segments) [rad] of the direction towards the head."""
    behind: np.ndarray
    """Distance (frames, segments) [m] along the body from the head to the middle of the segment."""


def measured_angles(midlines: Midlines) -> Angles:
    """Returns the measured angles, unwrapped (without jumps of 2 pi) along the body and in time."""
    steps = midlines.points[:, :-1] - midlines.points[:, 1:]
    size = np.hypot(steps[..., 0], steps[..., 1])
    phi = np.unwrap(np.arctan2(steps[..., 1], steps[..., 0]), axis=1)
    middle = phi.shape[1] // 2
    turns = np.unwrap(phi[:, middle]) - phi[:, middle]
    return Angles(phi + turns[:, None], np.cumsum(size, axis=1) - 0.5 * size)


def white_noise(series: np.ndarray) -> np.ndarray:
    """Returns the standard deviation (...) of white noise in `series` (times, ...)."""
    return np.sqrt(np.mean(np.diff(series, n=4, axis=0) ** 2, axis=0) / 70.0)


def smooth_along_body(
    measured: Angles, s: np.ndarray, wavelength: float
) -> tuple[np.ndarray, float]:
    """Returns smoothed phi (frames, nodes) [rad] at `s` [m] from the tail, and the rms residual."""
    L, rows, residuals = s[-1], [], []
    for phi, behind in zip(measured.phi, measured.behind, strict=True):
        fit = twicing_spline(behind / L, phi, 1.0 / wavelength)
        rows.append(fit((L - s) / L, 0))
        residuals.append(phi - fit(behind / L, 0))
    return np.array(rows), float(np.sqrt(np.mean(np.square(residuals))))


def choose_smoothing(midlines: Midlines) -> Smoothing:
    """Returns the wavelength and cutoff that remove only the measurement noise.

    The wavelength is the longest of `WAVELENGTHS` with a residual of at most `RESIDUAL_OVER_NOISE`
    times the noise of the angles. The cutoff is the first frequency above the stride frequency at
    which the power of the angles falls to `POWER_OVER_NOISE` times the noise power.
    """
    measured, length = measured_angles(midlines), float(np.median(midlines.lengths))
    noise = float(np.median(white_noise(measured.phi)))
    s = np.linspace(0.0, length, NODES)
    some = Angles(*(x[::FRAME_STRIDE] for x in measured))
    for wavelength in WAVELENGTHS:
        if smooth_along_body(some, s, wavelength)[1] <= RESIDUAL_OVER_NOISE * noise:
            break
    phi, _ = smooth_along_body(measured, s, wavelength)
    return Smoothing(wavelength, _noise_frequency(phi, midlines.interval))


def _noise_frequency(phi: np.ndarray, interval: float) -> float:
    """Returns the frequency [Hz] at which the power of phi (times, nodes) falls to the noise power.

    The noise power is the mean power above `NOISE_BAND` times the highest frequency.
    """
    frames = len(phi)
    straight = np.linspace(0.0, 1.0, frames)[:, None] * (phi[-1] - phi[0]) + phi[0]
    window = np.hanning(frames)[:, None]
    power = np.mean(np.abs(np.fft.rfft((phi - straight) * window, axis=0)) ** 2, axis=1)
    power = np.convolve(np.pad(power, 1, mode="edge"), np.ones(3) / 3.0, mode="valid")
    f = np.fft.rfftfreq(frames, interval)
    quiet = float(np.mean(power[f >= NOISE_BAND * f[-1]]))
    peak = int(np.argmax(power))
    below = np.flatnonzero(power[peak:] <= POWER_OVER_NOISE * quiet)
    return float(f[peak + below[0]]) if len(below) else float(f[-1])


def twicing_spline(x: np.ndarray, series: np.ndarray, cutoff: float) -> Callable[..., np.ndarray]:
    """Returns f(position, n), the n-th derivative of the smoothed `series` at the position."""
    weight = 1.0 / (np.mean(np.diff(x)) * (2.0 * math.pi * cutoff / _TWICING_RATIO) ** 4)
    first = make_smoothing_spline(x, series, lam=weight)
    second = make_smoothing_spline(x, series - first(x), lam=weight)
    return lambda at, n: first(at, nu=n) + second(at, nu=n)


def midline_motion(midlines: Midlines, smoothing: Smoothing, length: float | None = None) -> Motion:
    """Returns the motion of a body of `length` [m] (default: median of the traced lengths)."""
    L = float(np.median(midlines.lengths)) if length is None else length
    t, s = midlines.t, np.linspace(0.0, L, NODES)
    phi, _ = smooth_along_body(measured_angles(midlines), s, smoothing.wavelength)
    turning = twicing_spline(t, phi, smoothing.cutoff)
    head = twicing_spline(t, midlines.points[:, 0], smoothing.cutoff)
    return motion_from_angles(
        t, s, [turning(t, n) for n in range(3)], [head(t, n) for n in range(3)]
    )


def motion_from_angles(
    t: np.ndarray, s: np.ndarray, phi: list[np.ndarray], head: list[np.ndarray]
) -> Motion:
    """Returns the motion. `phi` is [phi, dphi/dt, d2phi/dt2], `head` is [r, V, A] of the head."""
    ds = np.diff(s)
    angle, omega, turn = (0.5 * (x[:, 1:] + x[:, :-1]) for x in phi)
    tau = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    n = np.stack([-np.sin(angle), np.cos(angle)], axis=-1)

    def from_head(start: np.ndarray, slope: np.ndarray) -> np.ndarray:
        behind = np.cumsum((slope * ds[:, None])[:, ::-1], axis=1)[:, ::-1]
        at_head = np.zeros_like(behind[:, :1])
        return start[:, None] - np.concatenate([behind, at_head], axis=1)

    return Motion(
        t=t,
        s=s,
        phi=phi[0],
        omega=phi[1],
        r=from_head(head[0], tau),
        V=from_head(head[1], omega[..., None] * n),
        A=from_head(head[2], turn[..., None] * n - omega[..., None] ** 2 * tau),
    )
