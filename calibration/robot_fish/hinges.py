"""Estimates the hinge angles of a swimming fish from its markers, robustly against lost markers.

The motor moves the tail in the shape M_1 that bends the hinges least for a pulled length, and the
water's load adds the shape M_2, which does not change the length of the tendons. The hinge angles
are first harmonics of the beat:

    theta(t) = Re((c_1 M_1 + c_2 M_2) exp(2 pi i f t))

Marker 8 on the fin is reliable, and markers 5 to 7 are not, so large errors have a small weight.
Markers 3 and 4 are close behind a hinge and hardly move, so errors of the head's direction would
dominate.
"""

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
PULLED = CRANK_STROKE * ARMS / (ARMS @ ARMS)
_LEVER = 0.46 - HINGES
_FREE = _LEVER - ARMS * (ARMS @ _LEVER) / (ARMS @ ARMS)
LOADED = 0.3 * _FREE / np.abs(np.cumsum(_FREE)).max()
"""M_1 and M_2, as hinge angles [rad]. M_2 is the response to a lateral force on the fin."""


def tail_positions(angles: Float[np.ndarray, "times 5"]) -> Float[np.ndarray, "times 5"]:
    """Returns the lateral positions [m] of the markers `USED` in the head's frame."""
    heading = np.cumsum(angles, axis=1)
    steps = np.diff(HINGES) * np.sin(heading[:, :-1])
    hinge = np.concatenate([np.zeros((len(angles), 1)), np.cumsum(steps, axis=1)], axis=1)
    x = MARKER_X[list(USED)]
    of = np.searchsorted(HINGES, x) - 1
    return hinge[:, of] + (x - HINGES[of]) * np.sin(heading[:, of])


def hinge_angles(run: MarkerRun) -> Complex[np.ndarray, " 5"]:
    """Returns the first harmonics [rad] of the hinge angles, positive to the left."""
    # One beat of the first harmonic of each marker, and the amplitude of each sample's noise.
    measured = behind_head(run.markers)[:, list(USED)]
    drift = np.stack([run.t**k for k in range(3)], axis=1)
    q = np.linalg.qr(drift)[0]
    measured = measured - q @ (q.T @ measured)
    wave = np.exp(2j * np.pi * run.beat * run.t)[:, None]
    reference = first_harmonic(run.t, measured[:, [USED.index(8)]], run.beat, 0)[0]

    def errors(z):
        c = z[:2] + 1j * z[2:]
        angles = np.real((c[0] * PULLED + c[1] * LOADED) * wave)
        position = tail_positions(angles)
        position = position - q @ (q.T @ position)
        found = ((position - measured) / POSITION_ERROR).ravel()
        return np.sign(found) * np.sqrt(np.log1p(found**2))

    start = np.array([reference / abs(reference), 0.0])
    z = least_squares(errors, np.concatenate([start.real, start.imag])).x
    return (z[0] + 1j * z[2]) * PULLED + (z[1] + 1j * z[3]) * LOADED
