"""Reads the markers of a robot fish, and computes its speed and its lateral motion from markers.

The folder of the data defines the speed: progress of the head's middle along the momentary
direction of the head. The same functions apply to measured and to simulated markers.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Complex, Float

from slider_jax.errors import InputError
from slider_jax.io.csv import read_csv
from slider_jax.io.toml import read_bytes

MARKERS = 9
"""Number of markers. Markers 0 and 1 are on the rigid head; marker 8 is on the tail fin."""
RELIABLE = (0, 1, 2, 8)
"""Markers that the tracker never loses."""
COLUMNS = tuple(f"{axis}{k}_m" for k in range(MARKERS) for axis in "xy")
"""Columns of a recording, after the time `t_s`."""
SUFFIX = "_lab.csv"
"""End of the name of a recording's file."""
LEAST_FRAMES = 60
"""Smallest number of frames of a recording, 1 s."""
LEAST_BEATS = 1.0
"""Smallest length of a recording in beats. With fewer beats, drift and beat cannot be separated."""
DRIFT = 2
"""Degree of the polynomial in time that describes the mean course."""
HARMONICS = 2
"""Number of harmonics of the beat that are fitted to the motion."""


@dataclass(frozen=True)
class MarkerRun:
    """Markers of a swimming fish, in a plane with x to the right and y upwards."""

    name: str
    beat: float
    """Beat frequency [Hz]."""
    t: Float[np.ndarray, " frames"]
    """Times [s]."""
    markers: Float[np.ndarray, "frames 9 2"]
    """Positions (x, y) [m]."""

    @property
    def speed(self) -> float:
        """Steady speed [m/s]."""
        return steady_speed_of(self.t, self.markers)


@dataclass(frozen=True)
class LateralMotion:
    """First harmonics of the motion across the mean course: x(t) = Re(X exp(2 pi i f t))."""

    sway: Complex[np.ndarray, " 9"]
    """Lateral displacement [m] of the markers, positive to the left of the course."""
    yaw: complex
    """Angle [rad] of the head, positive to the left."""


def read_beats(path: Path) -> dict[str, float]:
    """Returns the beat frequency [Hz] of each recording. Raises `InputError` for other content."""
    if not path.is_file():
        raise InputError(
            f'{path}: no such file; add this file with one line for each recording: {{"NAME": Hz}}'
        )
    try:
        beats = json.loads(read_bytes(path))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not JSON ({error}); allowed {{NAME: Hz}}") from None
    if not isinstance(beats, dict) or not beats:
        raise InputError(f"{path}: given {type(beats).__name__}; allowed {{NAME: Hz}}, not empty")
    for name, beat in beats.items():
        number = isinstance(beat, (int, float)) and not isinstance(beat, bool)
        if not number or not 0.05 <= beat <= 10.0:
            raise InputError.value(f"{path}, {name}", repr(beat), "a beat of 0.05 to 10 Hz")
    return {name: float(beat) for name, beat in beats.items()}


def read_marker_run(path: Path, beat: float) -> MarkerRun:
    """Returns the recording in a file NAME_lab.csv. Raises `InputError` for a damaged file."""
    columns = read_csv(path, ("t_s", *COLUMNS))
    t = columns["t_s"]
    if len(t) < LEAST_FRAMES or (t[-1] - t[0]) * beat < LEAST_BEATS:
        raise InputError(
            f"{path}: {len(t)} frames in {t[-1] - t[0]:.2f} s; allowed at least {LEAST_FRAMES} "
            f"frames and one beat ({1.0 / beat:.2f} s); record longer"
        )
    markers = np.stack([columns[name] for name in COLUMNS], axis=1).reshape(len(t), MARKERS, 2)
    head = np.linalg.norm(markers[:, 1] - markers[:, 0], axis=1)
    if np.any(head == 0.0):
        raise InputError(
            f"{path}, line {int(np.flatnonzero(head == 0.0)[0]) + 2}: markers 0 and 1 are at the "
            "same place, so the direction of the head is unknown; correct the markers"
        )
    # The file's y axis runs down in a picture from above; the model's y axis runs up.
    return MarkerRun(path.name.removesuffix(SUFFIX), beat, t, markers * np.array([1.0, -1.0]))


def read_marker_runs(folder: Path) -> list[MarkerRun]:
    """Returns the recordings NAME_lab.csv of a folder, sorted by beat. Raises `InputError`."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give a folder with NAME{SUFFIX} files")
    beats = read_beats(folder / "beats.json")
    paths = sorted(folder.glob(f"*{SUFFIX}"))
    if not paths:
        raise InputError(f"{folder}: no file NAME{SUFFIX}; give a folder with such files")
    for path in paths:
        name = path.name.removesuffix(SUFFIX)
        if name not in beats:
            raise InputError(
                f"{folder / 'beats.json'}: no beat of {name}, but {path.name} exists; given "
                f"{', '.join(beats)}; add the beat frequency of {name}"
            )
    found = [read_marker_run(p, beats[p.name.removesuffix(SUFFIX)]) for p in paths]
    return sorted(found, key=lambda x: x.beat)


def rotated(markers: Float[np.ndarray, "frames 9 2"]) -> Float[np.ndarray, "frames 9 2"]:
    """Returns the markers turned into the head's direction, as their source published them.

    p_i(t_n) = R(t_n) (r_i(t_n) - r_0(t_n)) + sum over k = 1..n of R(t_k) (c(t_k) - c(t_(k-1)))

    c is the mean of r_0 and r_1. R(t) turns the direction from marker 0 to marker 1 into +x.
    """
    ahead = markers[:, 1] - markers[:, 0]
    x, y = (ahead / np.linalg.norm(ahead, axis=1)[:, None]).T
    R = np.stack([np.stack([x, y], axis=-1), np.stack([-y, x], axis=-1)], axis=1)
    relative = np.einsum("nij,nkj->nki", R, markers - markers[:, :1])
    middle = 0.5 * (markers[:, 0] + markers[:, 1])
    steps = np.einsum("nij,nj->ni", R[1:], np.diff(middle, axis=0))
    course = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return relative + course[:, None]


def steady_speed_of(
    t: Float[np.ndarray, " frames"], markers: Float[np.ndarray, "frames 9 2"]
) -> float:
    """Returns the speed [m/s]: minus the slope of (x_0 + x_1)/2 of the `rotated` markers."""
    x = rotated(markers)[:, :2, 0].mean(axis=1)
    return -float(np.polyfit(t, x, 1)[0])


def first_harmonic(t, x, beat: float, drift: int = DRIFT) -> Complex[np.ndarray, "..."]:
    """Returns X of x(t) = drift + Re(X exp(2 pi i f t)) + higher harmonics, by least squares.

    `x` (frames, ...) are samples at the times `t` (frames,) [s].
    """
    basis = _basis(t, beat, drift)
    c = np.linalg.lstsq(basis, np.asarray(x).reshape(len(t), -1), rcond=None)[0]
    found = c[drift + 1] - 1j * c[drift + 2]
    return found.reshape(np.shape(x)[1:])


def _basis(t, beat: float, drift: int) -> np.ndarray:
    turns = 2.0 * np.pi * beat * np.asarray(t)
    powers = [np.asarray(t) ** k for k in range(drift + 1)]
    waves = [w(k * turns) for k in range(1, HARMONICS + 1) for w in (np.cos, np.sin)]
    return np.stack(powers + waves, axis=1)


def lateral_motion(t, markers, beat: float) -> LateralMotion:
    """Returns the motion of the markers (frames, 9, 2) [m] across the mean course."""
    middle = 0.5 * (markers[:, 0] + markers[:, 1])
    c = np.linalg.lstsq(_basis(t, beat, DRIFT), middle, rcond=None)[0][: DRIFT + 1]
    course = sum(c[k] * t[:, None] ** k for k in range(DRIFT + 1))
    ahead = sum(k * c[k] * t[:, None] ** (k - 1) for k in range(1, DRIFT + 1))
    ahead = ahead / np.linalg.norm(ahead, axis=1)[:, None]
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    sway = np.einsum("nki,ni->nk", markers - course[:, None], left)
    back = markers[:, 0] - markers[:, 1]
    angle = np.unwrap(np.arctan2(back[:, 1], back[:, 0]))
    return LateralMotion(
        first_harmonic(t, sway, beat), complex(first_harmonic(t, angle, beat, DRIFT + 1))
    )


def behind_head(markers: Float[np.ndarray, "frames 9 2"]) -> Float[np.ndarray, "frames 9"]:
    """Returns the lateral position [m] of the markers in the head's frame, positive to the left.

    The left is that of a fish that looks from marker 1 to marker 0.
    """
    ahead = markers[:, 0] - markers[:, 1]
    ahead = ahead / np.linalg.norm(ahead, axis=1)[:, None]
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    return np.einsum("nki,ni->nk", markers - markers[:, :1], left)
