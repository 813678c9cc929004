"""Creates and writes figures and animations."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

FRAME = 50
"""Duration [ms] of a frame in an animation."""


def new_figure(*shape: int, figsize: tuple[float, float], dpi: float | None = None, **kwargs):
    """Returns a figure that needs no display, and its axes.

    `figsize` is in inches; `shape` and `kwargs` are arguments of `Figure.subplots`.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize, dpi, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(*shape, **kwargs)


def save_figure(figure, path: Path) -> None:
    """Writes `figure` to `path`."""
    figure.savefig(path, dpi=150)


def save_film(
    figure,
    moving: Sequence,
    move: Callable[[int], None],
    shown: Sequence[int],
    path: Path,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> None:
    """Writes a GIF with one frame for each index in `shown`.

    `move(index)` updates the artists `moving`. All other artists are drawn only once, because texts
    take most of the drawing time. `progress(frames done, all frames)` is called after each frame.
    """
    from PIL import Image

    canvas, images = figure.canvas, []
    for artist in moving:
        artist.set_animated(True)
    canvas.draw()
    still = canvas.copy_from_bbox(figure.bbox)
    for number, index in enumerate(shown, start=1):
        move(index)
        canvas.restore_region(still)
        for artist in moving:
            artist.axes.draw_artist(artist)
        picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
        images.append(picture.quantize(128, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE))
        progress(number, len(shown))
    images[0].save(path, save_all=True, append_images=images[1:], duration=FRAME, loop=0)
