"""From midlines to the motion of a body that keeps its length: angles, velocities, accelerations.

The angle phi(s, t) of the midline is smoothed along the body and in time, and the body is laid out
again from the head:

    dr/ds = tau(phi),     r(L, t) the head's track

so that it does not stretch, whatever was measured. Distances along it are taken from the head: a
tracked head hardly jitters, and what a tracked length does is where the tail was seen to end.

Both smoothings are cubic smoothing splines applied to a series and once more to what they left
(twicing), which keeps a share 1 - (1 - g)^2 of an amplitude, g = 1/(1 + (f/f_1)^4) at frequency
or wavenumber f. Settings say where half an amplitude is kept. Source: Reinsch, C. H. (1967),
Smoothing by spline functions, Numer. Math. 10, 177-183; Tukey, J. W. (1977), Exploratory Data
Analysis, ch. 16.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.interpolate import make_smoothing_spline

from calibration.lamprey.midlines import Midlines

NODES = 81
"""Nodes of the body, evenly spaced."""
WAVELENGTHS = (0.6, 0.5, 0.4, 0.35, 0.3, 0.25, 0.2, 0.15)
"""Smoothing along the body that is tried: wavelengths of which half is kept, in body lengths."""
ABOVE_NOISE = 1.5
"""Smoothing is fine enough where the angles are off it by at most so many times their noise."""
EVERY = 4
"""Of the frames, one in so many is used to choose the wavelength."""
QUIET = 0.7
"""Above this share of the highest frequency the angles are taken to be noise alone."""
CLEAR = 2.0
"""The cutoff is where the angles' power comes down to so many times that noise."""
_TWICED = (1.0 / (1.0 - math.sqrt(0.5)) - 1.0) ** 0.25
"""cutoff over f_1."""


class Smoothing(NamedTuple):
    """How midlines are smoothed."""

    wavelength: float
    """Along the body, in body lengths, of which half the amplitude is kept."""
    cutoff: float
    """In time [Hz], at which half the amplitude is kept."""


class Motion(NamedTuple):
    """The body in time; arrays (times, nodes), nodes from the tail (s = 0) to the head (s = L)."""

    t: np.ndarray
    """(times,) [s]"""
    s: np.ndarray
    """(nodes,) [m]"""
    phi: np.ndarray
    """[rad]"""
    omega: np.ndarray
    """d(phi)/dt [rad/s]"""
    r: np.ndarray
    """(times, nodes, 2) [m]"""
    V: np.ndarray
    """(times, nodes, 2) [m/s]"""
    A: np.ndarray
    """(times, nodes, 2) [m/s^2]"""

    @property
    def length(self) -> float:
        """L [m]."""
        return float(self.s[-1])


class Angles(NamedTuple):
    """Angles of the segments between measured points."""

    phi: np.ndarray
    """(frames, segments) [rad], of the direction towards the head."""
    behind: np.ndarray
    """(frames, segments) [m], from the head to the segment's middle."""


def angles(midlines: Midlines) -> Angles:
    """The measured angles, continuous along the body and in time."""
    steps = midlines.points[:, :-1] - midlines.points[:, 1:]
    size = np.hypot(steps[..., 0], steps[..., 1])
    phi = np.unwrap(np.arctan2(steps[..., 1], steps[..., 0]), axis=1)
    middle = phi.shape[1] // 2
    turns = np.unwrap(phi[:, middle]) - phi[:, middle]
    return Angles(phi + turns[:, None], np.cumsum(size, axis=1) - 0.5 * size)


def white_noise(series: np.ndarray) -> np.ndarray:
    """Standard deviation of the white noise of series (times, ...), from fourth differences."""
    return np.sqrt(np.mean(np.diff(series, n=4, axis=0) ** 2, axis=0) / 70.0)


def along_body(measured: Angles, s: np.ndarray, wavelength: float) -> tuple[np.ndarray, float]:
    """phi (frames, nodes) [rad] at `s` [m] from the tail, and the rms [rad] of what is left out."""
    L, rows, left = s[-1], [], []
    for phi, behind in zip(measured.phi, measured.behind, strict=True):
        fit = twiced(behind / L, phi, 1.0 / wavelength)
        rows.append(fit((L - s) / L, 0))
        left.append(phi - fit(behind / L, 0))
    return np.array(rows), float(np.sqrt(np.mean(np.square(left))))


def choose_smoothing(midlines: Midlines) -> Smoothing:
    """Wavelength and cutoff at which only the measurement's noise is left out.

    The wavelength is the longest at which what is smoothed out is within `ABOVE_NOISE` of the noise
    of the angles; the cutoff is where, above the stride's frequency, the power of the angles comes
    down to `CLEAR` times that above `QUIET` of the highest frequency.
    """
    measured, length = angles(midlines), float(np.median(midlines.lengths))
    noise = float(np.median(white_noise(measured.phi)))
    s = np.linspace(0.0, length, NODES)
    some = Angles(*(x[::EVERY] for x in measured))
    for wavelength in WAVELENGTHS:
        if along_body(some, s, wavelength)[1] <= ABOVE_NOISE * noise:
            break
    phi, _ = along_body(measured, s, wavelength)
    return Smoothing(wavelength, cutoff(phi, midlines.interval))


def cutoff(phi: np.ndarray, interval: float) -> float:
    """Where the power of the angles (times, nodes) comes down to their noise [Hz].

    The power is the mean over the body and over three neighbouring frequencies.
    """
    frames = len(phi)
    straight = np.linspace(0.0, 1.0, frames)[:, None] * (phi[-1] - phi[0]) + phi[0]
    window = np.hanning(frames)[:, None]
    power = np.mean(np.abs(np.fft.rfft((phi - straight) * window, axis=0)) ** 2, axis=1)
    power = np.convolve(np.pad(power, 1, mode="edge"), np.ones(3) / 3.0, mode="valid")
    f = np.fft.rfftfreq(frames, interval)
    quiet = float(np.mean(power[f >= QUIET * f[-1]]))
    peak = int(np.argmax(power))
    below = np.flatnonzero(power[peak:] <= CLEAR * quiet)
    return float(f[peak + below[0]]) if len(below) else float(f[-1])


def twiced(x: np.ndarray, series: np.ndarray, cutoff: float) -> Callable[..., np.ndarray]:
    """(at, n) -> d^n/dx^n of the smoothed `series` (points, ...), half kept at `cutoff` [1/x]."""
    weight = 1.0 / (np.mean(np.diff(x)) * (2.0 * math.pi * cutoff / _TWICED) ** 4)
    first = make_smoothing_spline(x, series, lam=weight)
    second = make_smoothing_spline(x, series - first(x), lam=weight)
    return lambda at, n: first(at, nu=n) + second(at, nu=n)


def midline_motion(midlines: Midlines, smoothing: Smoothing, length: float | None = None) -> Motion:
    """The motion of a body of `length` [m] (default: the median) at the frames' times."""
    L = float(np.median(midlines.lengths)) if length is None else length
    t, s = midlines.t, np.linspace(0.0, L, NODES)
    phi, _ = along_body(angles(midlines), s, smoothing.wavelength)
    turning = twiced(t, phi, smoothing.cutoff)
    head = twiced(t, midlines.points[:, 0], smoothing.cutoff)
    return motion_from_angles(
        t, s, [turning(t, n) for n in range(3)], [head(t, n) for n in range(3)]
    )


def motion_from_angles(
    t: np.ndarray, s: np.ndarray, phi: list[np.ndarray], head: list[np.ndarray]
) -> Motion:
    """The body laid out from its head by its angles; `phi`, `head` with their two derivatives."""
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
