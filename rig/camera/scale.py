"""Converts pixels to metres, and computes the tip's excursion from the straight robot's axis."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from rig.camera.markers import import_opencv
from rig.errors import RigError

MISFIT = 0.005
"""Largest accepted rms residual of the board's corners, as a fraction of the board's size."""


class Lens(NamedTuple):
    """OpenCV's model of a pinhole camera with lens distortion."""

    matrix: np.ndarray
    """(3, 3) focal lengths and centre [px]."""
    coefficients: np.ndarray
    """(5,) distortion k1, k2, p1, p2, k3."""


@dataclass(frozen=True)
class Scale:
    """Mapping from pixels to metres in the plane in which the robot moves.

    `angle` [rad] is the angle from the image's right to the x axis, positive towards the image's
    bottom. Seen from above, the y axis points to the left of the x axis. `origin` [px] is in the
    undistorted image.
    """

    px_per_metre: float
    origin: tuple[float, float] = (0.0, 0.0)
    angle: float = 0.0
    from_below: bool = False
    """True if the camera is below the robot."""
    lens: Lens | None = None

    def metres(self, px: np.ndarray) -> np.ndarray:
        """Converts positions (..., 2) from px to m. A NaN remains a NaN."""
        flat = undistort(px, self.lens) - np.array(self.origin)
        cos, sin = np.cos(self.angle), np.sin(self.angle)
        along = flat[..., 0] * cos + flat[..., 1] * sin
        left = flat[..., 0] * sin - flat[..., 1] * cos
        if self.from_below:
            left = -left
        return np.stack([along, left], axis=-1) / self.px_per_metre

    def along(self, rest: np.ndarray) -> "Scale":
        """Returns the scale with the origin at the straight robot's tip and x towards the head.

        `rest` (markers, 2) [px] are the markers, tip first. The x axis is the line with the least
        squared distances from the markers. The y axis points to the robot's left.
        """
        positions = undistort(rest, self.lens)
        if len(positions) < 2 or not np.isfinite(positions).all():
            raise RigError.value(
                "camera: markers of the straight robot", np.round(rest, 1).tolist(), "two or more"
            )
        center = positions.mean(axis=0)
        axis = np.linalg.eigh(np.cov(positions.T))[1][:, 1]
        axis = axis * np.sign(axis @ (positions[-1] - positions[0]))
        tip = center + axis * (axis @ (positions[0] - center))
        angle = float(np.arctan2(axis[1], axis[0]))
        return replace(self, origin=(float(tip[0]), float(tip[1])), angle=angle)


def undistort(px: np.ndarray, lens: Lens | None) -> np.ndarray:
    """Returns positions (..., 2) [px] without the lens distortion."""
    px = np.asarray(px, float)
    if lens is None or not px.size:
        return px
    flat = np.ascontiguousarray(px.reshape(-1, 1, 2))
    # OpenCV cannot process NaN, so the image centre replaces NaN in this call.
    filled = np.where(np.isnan(flat), lens.matrix[:2, 2], flat)
    straight = import_opencv().undistortPoints(filled, *lens, P=lens.matrix).reshape(px.shape)
    return np.where(np.isnan(px), np.nan, straight)


def tip_excursion(xy: np.ndarray, scale: Scale) -> np.ndarray:
    """Returns the tip's lateral distance (frames,) [m] from the robot's axis, positive to the left.

    The tip is the first of the markers xy (frames, markers, 2) [px]. `Scale.along` gives `scale`.
    """
    return scale.metres(xy[:, 0])[:, 1]


def scale_of_points(
    first: tuple[float, float],
    second: tuple[float, float],
    distance: float,
    *,
    from_below: bool = False,
    lens: Lens | None = None,
) -> Scale:
    """Returns the scale from two points [px] at a `distance` [m]. x points from first to second."""
    if not (np.isfinite(distance) and distance > 0):
        raise RigError.value("camera: distance of two points", f"{distance} m", "above 0 m")
    px, metres = np.array([first, second]), np.array([[0.0, 0.0], [distance, 0.0]])
    return _fit(px, metres, from_below, lens)


def scale_of_checkerboard(
    image: np.ndarray,
    corners: tuple[int, int],
    square: float,
    *,
    from_below: bool = False,
    lens: Lens | None = None,
) -> Scale:
    """Returns the scale from an image (height, width, 3) of a checkerboard in the robot's plane.

    `corners` are the numbers of inner corners along and across the board. `square` [m] is a side of
    a square. x points along the board. Raises `RigError` if the board is not found or is tilted.
    """
    cv2 = import_opencv()
    gray = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    found, px = cv2.findChessboardCornersSB(gray, corners)
    if not found:
        raise RigError(
            f"camera: no checkerboard with {corners[0]} x {corners[1]} inner corners found; "
            "show the whole board, flat and evenly lit"
        )
    across, along = np.mgrid[: corners[1], : corners[0]]
    metres = square * np.stack([along, across], axis=-1).reshape(-1, 2)
    return _fit(px.reshape(-1, 2), metres, from_below, lens)


def scale_of_aruco(
    image: np.ndarray,
    markers: tuple[int, int],
    side: float,
    gap: float,
    *,
    dictionary: str = "DICT_4X4_50",
    from_below: bool = False,
    lens: Lens | None = None,
) -> Scale:
    """Returns the scale from an image (height, width, 3) of an ArUco grid board.

    `markers` are the numbers of markers along and across the board, `side` [m] is a marker's side,
    and `gap` [m] is the distance between markers. The board must be in the robot's plane. Raises
    `RigError` if fewer than half of the markers are found, or if the board is tilted.
    """
    aruco = import_opencv().aruco
    if not hasattr(aruco, dictionary):
        raise RigError.value("camera: ArUco dictionary", dictionary, "a name such as DICT_4X4_50")
    codes = aruco.getPredefinedDictionary(getattr(aruco, dictionary))
    board = aruco.GridBoard(markers, side, gap, codes)
    settings = aruco.DetectorParameters()
    settings.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
    corners, ids, _ = aruco.ArucoDetector(codes, settings).detectMarkers(image)
    seen = 0 if ids is None else len(ids)
    if 2 * seen < markers[0] * markers[1]:
        raise RigError(
            f"camera: {seen} of {markers[0] * markers[1]} ArUco markers ({dictionary}) found; "
            "at least half are needed; show the board flat and evenly lit"
        )
    metres, px = board.matchImagePoints(corners, ids)
    return _fit(px.reshape(-1, 2), metres.reshape(-1, 3)[:, :2], from_below, lens)


def _fit(px: np.ndarray, metres: np.ndarray, from_below: bool, lens: Lens | None) -> Scale:
    """Fits the scale to corners at `px` (n, 2) and at `metres` (n, 2), whose y points downwards."""
    straight = undistort(px, lens)
    z, w = straight @ [1, 1j], metres @ [1, 1j]
    # Both orders of the corners are fitted, because OpenCV may mirror a checkerboard's corners.
    fits = [np.linalg.lstsq(np.stack([v, np.ones_like(v)], 1), z)[0] for v in (w, w.conj())]
    off = [np.abs(z - a * v - b) for (a, b), v in zip(fits, (w, w.conj()), strict=True)]
    misfits = [float(np.sqrt(np.mean(e**2))) for e in off]
    (factor, origin), misfit = min(zip(fits, misfits, strict=True), key=lambda each: each[1])
    length = float(np.abs(z - z.mean()).max() * 2)
    if not length > 0:
        raise RigError.value("camera: points of the scale", straight.tolist(), "points far apart")
    if misfit > MISFIT * length:
        raise RigError.value(
            "camera: board",
            f"corners with an rms misfit of {misfit:.2g} px",
            f"up to {MISFIT * length:.2g} px",
            "put the board in the robot's plane, do not tilt it, or give the lens distortion",
        )
    return Scale(
        float(abs(factor)),
        (float(origin.real), float(origin.imag)),
        float(np.angle(factor)),
        from_below,
        lens,
    )
