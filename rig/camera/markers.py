"""Detects blue markers in an image and computes their centres to a fraction of a pixel.

Thresholds in HSV select the blue pixels. The centre of a marker is the centroid of the coverage.
The coverage is the fraction of a pixel that the marker covers. It is a linear function of colour: 1
on the marker and 0 around the marker. Fisher's discriminant (1936) makes this function insensitive
to the colours of body and water, and to white light. If glare saturates pixels, an ellipse with a
soft edge is fitted to the other pixels. A blue region is rejected if it is cut off by the image's
edge, too small, too long, mostly hidden by glare, or asymmetric.
"""

from typing import Any, NamedTuple

import numpy as np

from rig.camera.ellipse_fit import fit_ellipse, initial_ellipse
from rig.errors import RigError

MARGIN = 10
"""Margin of the image patch around a marker [px]."""
MIN_PIXELS = 30
"""Smallest number of pixels from which the background's colour or an ellipse is estimated."""
SMOOTH = (5, 5)
"""Window [px] of the moving average that smooths the background's colour."""
WHITE, NOISE = 100.0, 2.0
"""Assumed rms [counts] of white light and of sensor noise, added to the colour covariance."""


class MarkerCriteria(NamedTuple):
    """Criteria for a marker. Colours are OpenCV's HSV: hue in steps of 2 deg, others 0 to 255."""

    hue: tuple[int, int] = (102, 130)
    """Lowest and highest hue of a blue pixel."""
    saturation: int = 140
    """Lowest saturation of a blue pixel."""
    value: int = 40
    """Lowest value of a blue pixel."""
    glare: tuple[int, int] = (250, 190)
    """Lowest value and highest saturation of a pixel with glare."""
    area: tuple[float, float] = (30.0, 4000.0)
    """Smallest and largest area of the blue pixels [px^2]."""
    aspect: float = 5.0
    """Largest ratio of the long to the short axis, above 1 because motion blur lengthens a disc."""
    seen: float = 0.3
    """Smallest fraction of the marker's area that is free of glare."""
    error: float = 0.3
    """Largest standard error of the centre of a marker with glare [px]."""
    quality: float = 0.8
    """Lowest accepted `Marker.quality`."""


class Marker(NamedTuple):
    """One marker in one image."""

    x: float
    """Position of the centre [px], measured to the right from the centre of the first pixel."""
    y: float
    """Position of the centre [px], measured downwards from the centre of the first pixel."""
    mass: float
    """Covered area [px^2], independent of motion blur."""
    quality: float
    """Symmetry about the centre: 1 if opposite sides are equal, 0 if one side is empty."""


def import_opencv() -> Any:
    """Returns the module cv2. Raises `RigError` if OpenCV is not installed."""
    try:
        import cv2
    except ImportError:
        raise RigError(
            "camera: OpenCV is not installed; install it with pip install opencv-python-headless"
        ) from None
    return cv2


def find_markers(image: np.ndarray, criteria: MarkerCriteria = MarkerCriteria()) -> list[Marker]:
    """Returns the markers of an image, BGR uint8 (height, width, 3), in no particular order."""
    cv2 = import_opencv()
    hsv = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)
    low, high = (criteria.hue[0], criteria.saturation, criteria.value), (criteria.hue[1], 255, 255)
    blue = cv2.inRange(hsv, low, high)
    glare = cv2.inRange(hsv, (0, 0, criteria.glare[0]), (180, criteria.glare[1], 255))
    glare = cv2.dilate(glare, np.ones((3, 3), np.uint8))
    # A streak of glare must not split a marker into two.
    whole = blue | (glare & cv2.dilate(blue, np.ones((9, 9), np.uint8)))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(whole, connectivity=8)
    areas = np.bincount(labels[blue > 0], minlength=count)
    found = []
    for label in range(1, count):
        if not criteria.area[0] <= areas[label] <= criteria.area[1]:
            continue
        x, y, width, height = stats[label, :4]
        if x == 0 or y == 0 or x + width == image.shape[1] or y + height == image.shape[0]:
            continue
        left, top = max(x - MARGIN, 0), max(y - MARGIN, 0)
        patch = np.s_[top : y + height + MARGIN, left : x + width + MARGIN]
        own = (labels[patch] == label) & (blue[patch] > 0)
        other = (
            (labels[patch] != label) & (blue[patch] > 0) & (areas[labels[patch]] > criteria.area[0])
        )
        marker = _measure(cv2, image[patch], own, other, glare[patch] > 0, criteria)
        if marker is not None:
            found.append(marker._replace(x=marker.x + left, y=marker.y + top))
    return found


def _measure(
    cv2: Any,
    pixels: np.ndarray,
    own: np.ndarray,
    other: np.ndarray,
    glare: np.ndarray,
    criteria: MarkerCriteria,
) -> Marker | None:
    """Returns the marker with the blue pixels `own`, or None. `other`: other markers' pixels."""
    near = _dilated(cv2, own, 2)
    free = ~glare & ~_dilated(cv2, other, 4)
    around = free & ~_dilated(cv2, own, 4)
    if np.sum(around) < MIN_PIXELS or not np.any(own & free):
        return None
    coverage = _coverage(cv2, pixels.astype(np.float32), own & free, around)
    y, x = np.mgrid[: own.shape[0], : own.shape[1]].astype(float)

    weight = np.where(near & free, coverage, 0.0)
    mass, center, covariance = _moments(x, y, weight)
    if not _is_round(covariance, mass, criteria):
        return None
    if np.any(near & glare):
        seen = free & _dilated(cv2, own, 7)
        if np.sum(seen) < MIN_PIXELS:
            return None
        fitted = fit_ellipse(
            x[seen], y[seen], coverage[seen], initial_ellipse(center, covariance, mass)
        )
        if fitted is None or fitted[1] > criteria.error:
            return None
        ellipse = fitted[0]
        center, mass = np.array(ellipse[:2]), ellipse.mass
        inside = ellipse.inside(x, y)
        if np.sum(inside & free) < criteria.seen * np.sum(inside):
            return None
    quality = 1 - _asymmetry(cv2, coverage, free, near, around, center)
    if quality < criteria.quality:
        return None
    return Marker(float(center[0]), float(center[1]), float(mass), quality)


def _dilated(cv2: Any, mask: np.ndarray, pixels: int) -> np.ndarray:
    """Returns a mask widened by `pixels`."""
    square = np.ones((2 * pixels + 1, 2 * pixels + 1), np.uint8)
    return cv2.dilate(mask.astype(np.uint8), square) > 0


def _coverage(cv2: Any, levels: np.ndarray, own: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Returns the coverage of each pixel, from the colours on the marker and around the marker.

    The background is smoothed, because its uneven colour shifts the centroid more than noise does.
    """
    share = cv2.blur(around.astype(np.float32), SMOOTH)[around]
    background = cv2.blur(levels * around[..., None], SMOOTH)[around] / share[:, None]
    mean = background.mean(axis=0)
    contrast = np.median(levels[own], axis=0) - mean
    covariance = np.cov(background.T) + WHITE**2 * np.ones((3, 3)) + NOISE**2 * np.eye(3)
    direction = np.linalg.solve(covariance, contrast)
    return (levels - mean) @ (direction / max(direction @ contrast, 1e-9))


def _moments(
    x: np.ndarray, y: np.ndarray, weight: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Returns sum, centroid (2,) and covariance (2, 2) of the weights of a patch."""
    mass = weight.sum()
    if mass <= 0:
        return 0.0, np.zeros(2), np.zeros((2, 2))
    center = np.array([(weight * x).sum(), (weight * y).sum()]) / mass
    dx, dy = x - center[0], y - center[1]
    cross = (weight * dx * dy).sum()
    covariance = np.array([[(weight * dx * dx).sum(), cross], [cross, (weight * dy * dy).sum()]])
    return float(mass), center, covariance / mass


def _is_round(covariance: np.ndarray, mass: float, criteria: MarkerCriteria) -> bool:
    """Returns whether the ratio of the axes is at most `criteria.aspect`."""
    short, long = np.linalg.eigvalsh(covariance)
    return mass > 0 and short > 0 and long < criteria.aspect**2 * short


def _asymmetry(
    cv2: Any,
    coverage: np.ndarray,
    free: np.ndarray,
    near: np.ndarray,
    around: np.ndarray,
    center: np.ndarray,
) -> float:
    """Returns the relative rms change (0 to 1) of the coverage if it is turned by 180 deg."""
    turn = np.array([[-1, 0, 2 * center[0]], [0, -1, 2 * center[1]]])
    size, flags = coverage.shape[::-1], cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    turned = cv2.warpAffine(coverage, turn, size, flags=flags)
    seen = cv2.warpAffine(free.astype(np.float32), turn, size, flags=flags) > 0.99
    here = free & seen & (near | (cv2.warpAffine(near.astype(np.float32), turn, size) > 0.5))
    noise = 2 * np.var(coverage[around]) * np.sum(here)
    difference = np.sum((coverage[here] - turned[here]) ** 2) - noise
    whole = np.sum(coverage[here] ** 2 + turned[here] ** 2)
    return float(np.sqrt(min(max(difference, 0.0) / whole, 1.0))) if whole > 0 else 1.0
