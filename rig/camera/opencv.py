"""OpenCV, which only the camera needs."""

from typing import Any

from rig.errors import RigError


def opencv() -> Any:
    """The module cv2. Raises `RigError` where it is not installed."""
    try:
        import cv2
    except ImportError:
        raise RigError(
            "camera: OpenCV is not installed; install it with pip install opencv-python-headless"
        ) from None
    return cv2
