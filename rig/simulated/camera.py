"""A simulated camera above a tank, which yields images of blue markers on a moving body.

The disturbances are motion blur, glare that saturates part of a marker, sensor noise, covered
markers and dropped frames. By default, all are off. A frame depends only on seed and frame number.
"""

import os
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rig.camera.markers import import_opencv
from rig.camera.source import Shot
from rig.errors import RigError

FINE = 5
"""Number of samples along each side of a pixel."""
AVI_FRAMES, AVI_LENGTH = 48, 140
"""Byte offsets of the number of frames in an AVI with one stream: dwTotalFrames and dwLength."""
MARKER, BODY = (196.0, 78.0, 26.0), (66.0, 62.0, 58.0)
"""Colours of a marker and of the robot's body: blue, green, red [counts]."""


@dataclass(frozen=True)
class Scene:
    """The scene in front of the camera, and the camera's properties.

    `path` returns the marker positions (k, markers, 2) [px] at times (k,) [s], in order along the
    body. `hidden` contains the covered markers as (frame, marker), `dropped` the missing frames.
    """

    path: Callable[[np.ndarray], np.ndarray]
    frames: int
    size: tuple[int, int] = (360, 640)
    """Height and width [px]."""
    fps: float = 100.0
    radius: float = 7.0
    """Radius of a marker [px]."""
    exposure: float = 0.0
    """Exposure time [s]."""
    glare: float = 0.0
    """Probability of glare on a marker in a frame."""
    noise: float = 0.0
    """Rms noise of a colour channel [counts], without the shot noise of the light."""
    hidden: frozenset[tuple[int, int]] = frozenset()
    dropped: frozenset[int] = frozenset()
    seed: int = 0

    def truth(self, number: int) -> np.ndarray:
        """Returns the marker positions (markers, 2) [px] at the middle of a frame's exposure."""
        return self.path(np.array([number / self.fps]))[0]

    def image(self, number: int) -> np.ndarray:
        """Returns frame `number`, BGR uint8 (height, width, 3)."""
        cv2 = import_opencv()
        rng = np.random.default_rng([self.seed, number])
        light = _water(self.size, number / self.fps, self.seed)
        open_for = self.exposure * np.linspace(-0.5, 0.5, 17 if self.exposure else 1)
        positions = self.path(number / self.fps + open_for)
        _draw_body(light, positions[len(positions) // 2], self.radius)
        for marker in range(positions.shape[1]):
            if (number, marker) in self.hidden:
                continue
            _draw_marker(light, positions[:, marker], self.radius)
            if rng.random() < self.glare:
                _draw_glare(light, positions[len(positions) // 2, marker], self.radius, rng)
        light = cv2.GaussianBlur(light, (0, 0), 0.7)
        if self.noise:
            spread = np.sqrt(self.noise**2 + 0.02 * light)
            light = light + spread * rng.standard_normal(light.shape, dtype=np.float32)
        return np.clip(np.rint(light), 0, 255).astype(np.uint8)


class SimulatedCamera:
    """A `rig.camera.source.Source` that draws the next frame of a scene when `read` is called."""

    live = False

    def __init__(self, scene: Scene, name: str = "simulated camera"):
        self.name, self.fps, self._scene = name, scene.fps, scene
        self._left = iter(n for n in range(scene.frames) if n not in scene.dropped)

    def read(self) -> Shot | None:
        """Returns the next frame that is not dropped, with the time since the scene's start."""
        number = next(self._left, None)
        if number is None:
            return None
        time_ns = round(number / self.fps * 1e9)
        return Shot(time_ns, time_ns, self._scene.image(number))

    def close(self) -> None:
        """Does nothing: there is no device to close."""


def write_video(path: Path | str, scene: Scene) -> None:
    """Writes the scene as a lossless AVI (FFV1).

    A dropped frame becomes an empty chunk, so the other frames keep their times.
    """
    cv2 = import_opencv()
    path = Path(path)
    temporary = path.with_name(f".tmp-{path.name}")
    height, width = scene.size
    code = cv2.VideoWriter_fourcc(*"FFV1")
    writer = cv2.VideoWriter(str(temporary), cv2.CAP_FFMPEG, code, scene.fps, (width, height))
    if not writer.isOpened():
        raise RigError(f"{path}: cannot be written as FFV1 video; use another folder")
    for number in range(scene.frames):
        if number not in scene.dropped:
            writer.write(scene.image(number))
    writer.release()
    if scene.dropped:
        temporary.write_bytes(_with_gaps(temporary.read_bytes(), scene))
    os.replace(temporary, path)


def _with_gaps(avi: bytes, scene: Scene) -> bytes:
    """Returns an AVI with an empty chunk per dropped frame, and without an index."""
    start = avi.index(b"movi") + 4
    chunks, at = [], start
    for number in range(scene.frames):
        if number in scene.dropped:
            chunks.append(b"00dc" + bytes(4))
            continue
        size = struct.unpack_from("<I", avi, at + 4)[0]
        chunks.append(avi[at : at + 8 + size + size % 2])
        at += len(chunks[-1])
    body = b"".join(chunks)
    whole = bytearray(avi[:start] + body)
    for offset, count in (
        (4, len(whole) - 8),
        (start - 8, len(body) + 4),
        (AVI_FRAMES, scene.frames),
        (AVI_LENGTH, scene.frames),
    ):
        struct.pack_into("<I", whole, offset, count)
    return bytes(whole)


def _water(size: tuple[int, int], t: float, seed: int) -> np.ndarray:
    """Returns an image (height, width, 3) of uneven water with moving caustics."""
    rng = np.random.default_rng([seed, 10**6])
    y, x = np.mgrid[0 : size[0] : 4, 0 : size[1] : 4].astype(np.float32)
    swell, warp = np.zeros_like(x), np.zeros_like(x)
    for _ in range(6):
        heading, length = rng.uniform(0, 2 * np.pi), rng.uniform(60, 200)
        phase = 2 * np.pi * ((x * np.cos(heading) + y * np.sin(heading)) / length)
        wave = np.sin(phase + rng.uniform(0, 2 * np.pi) + rng.uniform(3, 9) * t)
        swell += wave / 6
        warp += 2 * np.sin(1.7 * phase + 3 * wave)
    caustics = np.exp(-((warp / 1.2) ** 2))
    bright = 1 + 0.12 * swell + 0.25 * caustics
    colour = np.array([138.0, 120.0, 72.0], np.float32)
    field = bright[..., None] * colour
    return import_opencv().resize(field, size[::-1], interpolation=import_opencv().INTER_CUBIC)


def _draw_body(light: np.ndarray, positions: np.ndarray, radius: float) -> None:
    """Draws a dark band along the markers, narrower than a marker at the tip."""
    points = np.rint(positions * 16).astype(int).tolist()
    cover = np.zeros(light.shape[:2], np.uint8)
    cv2 = import_opencv()
    widths = np.linspace(1.6, 3.4, len(points))[1:] * radius
    for start, end, width in zip(points, points[1:], widths, strict=False):
        cv2.line(cover, start, end, 255, round(width), cv2.LINE_AA, 4)
    share = cover[..., None].astype(np.float32) / 255
    light *= 1 - share
    light += share * np.array(BODY, np.float32)


def _patch(light: np.ndarray, positions: np.ndarray, reach: float) -> tuple[int, int, int, int]:
    """Returns left, top, right, bottom of the image area within `reach` of positions (k, 2)."""
    low = np.maximum(np.floor(positions.min(axis=0) - reach), 0).astype(int)
    high = np.ceil(positions.max(axis=0) + reach + 1).astype(int)
    return low[0], low[1], min(high[0], light.shape[1]), min(high[1], light.shape[0])


def _draw_marker(light: np.ndarray, positions: np.ndarray, radius: float) -> None:
    """Draws a disc, averaged over positions (k, 2) [px], with `FINE`^2 samples per pixel."""
    left, top, right, bottom = _patch(light, positions, radius)
    if left >= right or top >= bottom:
        return
    x = left - 0.5 + (np.arange((right - left) * FINE, dtype=np.float32) + 0.5) / FINE
    y = top - 0.5 + (np.arange((bottom - top) * FINE, dtype=np.float32) + 0.5) / FINE
    cover = np.zeros((len(y), len(x)), np.float32)
    for px, py in positions:
        cover += (x[None] - px) ** 2 + (y[:, None] - py) ** 2 < radius**2
    cover /= len(positions)
    share = cover.reshape(bottom - top, FINE, right - left, FINE).mean(axis=(1, 3))[..., None]
    here = light[top:bottom, left:right]
    here += share * (np.array(MARKER, np.float32) - here)


def _draw_glare(
    light: np.ndarray, center: np.ndarray, radius: float, rng: np.random.Generator
) -> None:
    """Draws saturated white light on a part of a marker and beside the marker."""
    angle, turn = rng.uniform(0, 2 * np.pi, 2)
    away = radius * rng.uniform(0.2, 1.1)
    x0, y0 = center[0] + away * np.cos(angle), center[1] + away * np.sin(angle)
    long, short = radius * rng.uniform(0.35, 0.6), radius * rng.uniform(0.25, 0.4)
    left, top, right, bottom = _patch(light, np.array([[x0, y0]]), 3 * radius)
    y, x = np.mgrid[top:bottom, left:right].astype(np.float32)
    u = ((x - x0) * np.cos(turn) + (y - y0) * np.sin(turn)) / long
    v = ((y - y0) * np.cos(turn) - (x - x0) * np.sin(turn)) / short
    light[top:bottom, left:right] += (600 * np.exp(-(u**2 + v**2)))[..., None]
