"""Figures and films: how all of them are made and written."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

FRAME = 50
"""Time that a picture of a film is shown [ms]."""


def new_figure(*args, **kwargs):
    """A figure and its axes, drawn without a display."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt.subplots(*args, layout="constrained", **kwargs)


def save_figure(figure, path: Path) -> None:
    """Write the picture and let go of the figure."""
    import matplotlib.pyplot as plt

    figure.savefig(path, dpi=150)
    plt.close(figure)


def save_film(
    figure,
    moving: Sequence,
    move: Callable[[int], None],
    shown: Sequence[int],
    path: Path,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> None:
    """Write a GIF of a picture for each of `shown`, and let go of the figure.

    `move` takes the artists `moving` to it; what does not move is drawn once, for its texts take
    most of a picture's time. `progress(pictures done, all)` is called at each.
    """
    import matplotlib.pyplot as plt
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
    plt.close(figure)
    images[0].save(path, save_all=True, append_images=images[1:], duration=FRAME, loop=0)
