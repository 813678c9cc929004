"""Estimates the hinge angles of a swimming fish from its markers, robustly against lost markers.

The motor moves the tail in the shape M_1 that bends the hinges least for a pulled length, and the
water's load adds the shape M_2, which does not change the length of the tendons. The hinge angles
are first harmonics of the beat:

    theta(t) = Re((c_1 M_1 + c_2 M_2) exp(2 pi i f t))

Marker 8 on the fin is reliable, and markers 5 to 7 are not. A prior for the ratio c_2/c_1, which
is linear in f^2 as the water's load, makes the estimate possible from marker 8 alone. Markers 3 and
4 are close behind a hinge and hardly move, so errors of the head's direction would dominate.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float
from scipy.optimize import least_squares

from calibration.robot_fish.fish import HINGES, MARKER_X, ROUTE_X, ROUTE_Y
from calibration.robot_fish.markers import MarkerRun, behind_head, first_harmonic

ARMS = np.interp(HINGES, ROUTE_X, ROUTE_Y)
"""Lever arms [m] of a tendon about the hinges."""
CRANK_STROKE = 0.0345
"""Amplitude [m] of the pulled length, for which M_1 is scaled."""
USED = (5, 6, 7, 8)
"""Markers that are used."""
POSITION_ERROR = 4e-3
"""Standard deviation [m] of a marker's lateral position; parallax of the camera dominates."""
RATIO_ERROR = 0.5
"""Standard deviation of the prior of c_2/c_1; the ratio is 1.6 and 2.6 in the two known runs."""
PULLED = CRANK_STROKE * ARMS / (ARMS @ ARMS)
_LEVER = 0.46 - HINGES
_FREE = _LEVER - ARMS * (ARMS @ _LEVER) / (ARMS @ ARMS)
LOADED = 0.3 * _FREE / np.abs(np.cumsum(_FREE)).max()
"""M_1 and M_2, as hinge angles [rad]. M_2 is the response to a lateral force on the fin."""


@dataclass(frozen=True)
class LoadRatio:
    """Prior of c_2/c_1 = `still` + `rise` f^2, with the beat f [Hz]."""

    still: complex
    rise: complex

    def at(self, beat: float) -> complex:
        """Returns the expected ratio at `beat` [Hz]."""
        return self.still + self.rise * beat**2


def tail_positions(angles: Float[np.ndarray, "times 5"]) -> Float[np.ndarray, "times 5"]:
    """Returns the lateral positions [m] of the markers `USED` in the head's frame."""
    heading = np.cumsum(angles, axis=1)
    steps = np.diff(HINGES) * np.sin(heading[:, :-1])
    hinge = np.concatenate([np.zeros((len(angles), 1)), np.cumsum(steps, axis=1)], axis=1)
    x = MARKER_X[list(USED)]
    of = np.searchsorted(HINGES, x) - 1
    return hinge[:, of] + (x - HINGES[of]) * np.sin(heading[:, of])


def hinge_angles(
    run: MarkerRun, ratio: LoadRatio | None = None, markers: tuple[int, ...] = USED
) -> Complex[np.ndarray, " 5"]:
    """Returns the first harmonics [rad] of the hinge angles, positive to the left.

    Without `ratio`, there is no prior. `markers` are those of `USED` that the estimate may use.
    """
    columns = [USED.index(k) for k in markers]
    # One beat of the first harmonic of each marker, and the amplitude of each sample's noise.
    measured = behind_head(run.markers)[:, list(markers)]
    drift = np.stack([run.t**k for k in range(3)], axis=1)
    q = np.linalg.qr(drift)[0]
    measured = measured - q @ (q.T @ measured)
    wave = np.exp(2j * np.pi * run.beat * run.t)[:, None]
    reference = first_harmonic(run.t, measured[:, [markers.index(8)]], run.beat, 0)[0]
    # Neighbouring frames have the same error of parallax, so a beat counts as ten samples.
    weight = np.sqrt(10.0 * (run.t[-1] - run.t[0]) * run.beat / len(run.t)) / POSITION_ERROR

    def errors(z):
        c = z[:2] + 1j * z[2:]
        angles = np.real((c[0] * PULLED + c[1] * LOADED) * wave)
        position = tail_positions(angles)[:, columns]
        position = position - q @ (q.T @ position)
        found = ((position - measured) / POSITION_ERROR).ravel()
        found = np.sign(found) * np.sqrt(np.log1p(found**2)) * weight * POSITION_ERROR
        if ratio is None:
            return found
        off = (c[1] - ratio.at(run.beat) * c[0]) / (RATIO_ERROR * abs(c[0]))
        return np.concatenate([found, [off.real, off.imag]])

    first = reference / abs(reference)
    second = first * (ratio.at(run.beat) if ratio else 0.0)
    start = np.array([first, second])
    z = least_squares(errors, np.concatenate([start.real, start.imag])).x
    return (z[0] + 1j * z[2]) * PULLED + (z[1] + 1j * z[3]) * LOADED


def load_ratio_of(angles: list[np.ndarray], beats: list[float]) -> LoadRatio:
    """Returns the ratio c_2/c_1 through two runs with the hinge `angles` (5,) and the `beats`."""
    basis = np.stack([PULLED, LOADED], axis=1)
    ratios = []
    for A in angles:
        c = np.linalg.lstsq(basis, A, rcond=None)[0]
        ratios.append(c[1] / c[0])
    rise = (ratios[1] - ratios[0]) / (beats[1] ** 2 - beats[0] ** 2)
    return LoadRatio(ratios[0] - rise * beats[0] ** 2, rise)
