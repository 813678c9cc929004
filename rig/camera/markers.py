"""Blue markers in an image: their centres, to a fraction of a pixel.

Blue is what the threshold in HSV says. The centre is the centroid of how much of each pixel the
marker covers: the linear function of colour that is 1 on the marker, 0 on what is around it, and
least moved by what varies there, be it body or water, and by white light (Fisher's discriminant,
1936). Where glare has saturated pixels, they say nothing: a soft ellipse is fitted to the others.
What is cut off, too small, too long, too covered or not the same on both sides of its centre is no
marker.
"""

from typing import Any, NamedTuple

import numpy as np

from rig.camera.ellipse_fit import fit_ellipse, start_at
from rig.errors import RigError

MARGIN = 10
"""Of the patch around a marker [px]."""
FEWEST = 30
"""Pixels to tell the background by, or to fit to."""
SMOOTH = (5, 5)
"""Mean over so many pixels before telling what varies around a marker."""
WHITE, NOISE = 100.0, 2.0
"""Rms of white light and of the sensor [counts], at least, in what varies around a marker."""


class Look(NamedTuple):
    """What counts as a marker. HSV is OpenCV's: hue in steps of two degrees, the others to 255."""

    hue: tuple[int, int] = (102, 130)
    saturation: int = 140
    """Least."""
    value: int = 40
    """Least."""
    glare: tuple[int, int] = (250, 190)
    """Least value, highest saturation of a pixel that white light has saturated."""
    area: tuple[float, float] = (30.0, 4000.0)
    """Of the blue pixels [px^2]."""
    aspect: float = 5.0
    """Highest ratio of the axes; motion blur makes a disc longer."""
    seen: float = 0.3
    """Least share that is free of glare."""
    error: float = 0.3
    """Highest standard error of the centre of one with glare on it [px]."""
    quality: float = 0.8
    """Least."""


class Marker(NamedTuple):
    """One marker in one image."""

    x: float
    """From the centre of the first pixel to the right [px]."""
    y: float
    """Downwards [px]."""
    mass: float
    """Area that it covers [px^2]; the same with and without motion blur."""
    quality: float
    """1 for the same on both sides of its centre, 0 for all on one side."""


def import_opencv() -> Any:
    """The module cv2. Raises `RigError` where it is not installed."""
    try:
        import cv2
    except ImportError:
        raise RigError(
            "camera: OpenCV is not installed; install it with pip install opencv-python-headless"
        ) from None
    return cv2


def find_markers(image: np.ndarray, look: Look = Look()) -> list[Marker]:
    """The markers of an image, BGR uint8 (height, width, 3), in no order."""
    cv2 = import_opencv()
    hsv = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)
    low, high = (look.hue[0], look.saturation, look.value), (look.hue[1], 255, 255)
    blue = cv2.inRange(hsv, low, high)
    glare = cv2.inRange(hsv, (0, 0, look.glare[0]), (180, look.glare[1], 255))
    glare = cv2.dilate(glare, np.ones((3, 3), np.uint8))
    # A streak of glare does not part a marker in two.
    whole = blue | (glare & cv2.dilate(blue, np.ones((9, 9), np.uint8)))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(whole, connectivity=8)
    areas = np.bincount(labels[blue > 0], minlength=count)
    found = []
    for label in range(1, count):
        if not look.area[0] <= areas[label] <= look.area[1]:
            continue
        x, y, width, height = stats[label, :4]
        if x == 0 or y == 0 or x + width == image.shape[1] or y + height == image.shape[0]:
            continue
        left, top = max(x - MARGIN, 0), max(y - MARGIN, 0)
        patch = np.s_[top : y + height + MARGIN, left : x + width + MARGIN]
        own = (labels[patch] == label) & (blue[patch] > 0)
        other = (labels[patch] != label) & (blue[patch] > 0) & (areas[labels[patch]] > look.area[0])
        marker = _measure(cv2, image[patch], own, other, glare[patch] > 0, look)
        if marker is not None:
            found.append(marker._replace(x=marker.x + left, y=marker.y + top))
    return found


def _measure(
    cv2: Any,
    pixels: np.ndarray,
    own: np.ndarray,
    other: np.ndarray,
    glare: np.ndarray,
    look: Look,
) -> Marker | None:
    """The marker of the blue pixels `own` of a patch."""
    near = _wider(cv2, own, 2)
    free = ~glare & ~_wider(cv2, other, 4)
    around = free & ~_wider(cv2, own, 4)
    if np.sum(around) < FEWEST or not np.any(own & free):
        return None
    cover = _cover(cv2, pixels.astype(np.float32), own & free, around)
    y, x = np.mgrid[: own.shape[0], : own.shape[1]].astype(float)

    weight = np.where(near & free, cover, 0.0)
    mass, center, covariance = _moments(x, y, weight)
    if not _is_round(covariance, mass, look):
        return None
    if np.any(near & glare):
        seen = free & _wider(cv2, own, 7)
        if np.sum(seen) < FEWEST:
            return None
        fitted = fit_ellipse(x[seen], y[seen], cover[seen], start_at(center, covariance, mass))
        if fitted is None or fitted[1] > look.error:
            return None
        ellipse = fitted[0]
        center, mass = np.array(ellipse[:2]), ellipse.mass
        inside = ellipse.inside(x, y)
        if np.sum(inside & free) < look.seen * np.sum(inside):
            return None
    quality = 1 - _asymmetry(cv2, cover, free, near, around, center)
    if quality < look.quality:
        return None
    return Marker(float(center[0]), float(center[1]), float(mass), quality)


def _wider(cv2: Any, mask: np.ndarray, pixels: int) -> np.ndarray:
    """A mask and all within so many pixels of it."""
    square = np.ones((2 * pixels + 1, 2 * pixels + 1), np.uint8)
    return cv2.dilate(mask.astype(np.uint8), square) > 0


def _cover(cv2: Any, levels: np.ndarray, own: np.ndarray, around: np.ndarray) -> np.ndarray:
    """How much of each pixel the marker covers, from the colours of its own and of those around.

    Those around are smoothed: of what varies, patches move a centroid more than the sensor's noise.
    """
    share = cv2.blur(around.astype(np.float32), SMOOTH)[around]
    background = cv2.blur(levels * around[..., None], SMOOTH)[around] / share[:, None]
    mean = background.mean(axis=0)
    contrast = np.median(levels[own], axis=0) - mean
    varies = np.cov(background.T) + WHITE**2 * np.ones((3, 3)) + NOISE**2 * np.eye(3)
    direction = np.linalg.solve(varies, contrast)
    return (levels - mean) @ (direction / max(direction @ contrast, 1e-9))


def _moments(
    x: np.ndarray, y: np.ndarray, weight: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Sum, centroid (2,) and covariance (2, 2) of a weight over a patch."""
    mass = weight.sum()
    if mass <= 0:
        return 0.0, np.zeros(2), np.zeros((2, 2))
    center = np.array([(weight * x).sum(), (weight * y).sum()]) / mass
    dx, dy = x - center[0], y - center[1]
    cross = (weight * dx * dy).sum()
    covariance = np.array([[(weight * dx * dx).sum(), cross], [cross, (weight * dy * dy).sum()]])
    return float(mass), center, covariance / mass


def _is_round(covariance: np.ndarray, mass: float, look: Look) -> bool:
    """No longer than motion blur makes a disc."""
    short, long = np.linalg.eigvalsh(covariance)
    return mass > 0 and short > 0 and long < look.aspect**2 * short


def _asymmetry(
    cv2: Any,
    cover: np.ndarray,
    free: np.ndarray,
    near: np.ndarray,
    around: np.ndarray,
    center: np.ndarray,
) -> float:
    """From 0 to 1: the share of the marker that its turn by half a circle about `center` lacks."""
    turn = np.array([[-1, 0, 2 * center[0]], [0, -1, 2 * center[1]]])
    size, flags = cover.shape[::-1], cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    turned = cv2.warpAffine(cover, turn, size, flags=flags)
    seen = cv2.warpAffine(free.astype(np.float32), turn, size, flags=flags) > 0.99
    here = free & seen & (near | (cv2.warpAffine(near.astype(np.float32), turn, size) > 0.5))
    noise = 2 * np.var(cover[around]) * np.sum(here)
    differ = np.sum((cover[here] - turned[here]) ** 2) - noise
    whole = np.sum(cover[here] ** 2 + turned[here] ** 2)
    return float(np.sqrt(min(max(differ, 0.0) / whole, 1.0))) if whole > 0 else 1.0
