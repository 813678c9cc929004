"""Writes an interactive view of a trial: one HTML file that a browser opens without a network."""

import base64
from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from jinja2 import Environment, PackageLoader, StrictUndefined

from slider_jax.beam.parameters import Numerics
from slider_jax.dynamics.model import Model, make_mesh
from slider_jax.io.files import write_text
from slider_jax.simulation.plots import last_strides, run_title
from slider_jax.simulation.shape import SavedShape, saved_shape
from slider_jax.simulation.trial import TrialRun

FRAMES, STRIDES, NODES = 301, 15, 101
"""Largest numbers of frames, of strides and of nodes in a view.

With them, a file is smaller than 1.5 MB, and a stride has at least 20 frames.
"""
_TEMPLATES = Environment(
    loader=PackageLoader("slider_jax.simulation"), autoescape=True, undefined=StrictUndefined
)


def write_view(run: TrialRun, folder: Path) -> Path:
    """Writes `<stem>_view.html` and returns the path.

    The view shows the last `STRIDES` strides of the trial: the body as a ribbon along the axes tau
    and b of its sections, with the height of the sections; the paths of head and tip; and the force
    per length. The positions are those in the tank, or relative to the clamp.
    """
    path = folder / f"{Path(run.trial.file).stem}_view.html"
    page = _TEMPLATES.get_template("view.html").render(title=run_title(run), data=view_data(run))
    write_text(path, page)
    return path


def view_data(run: TrialRun) -> dict[str, Any]:
    """Returns the content of a view, in ms, mm and N/m; arrays are from `packed`."""
    shown = min(FRAMES, run.grid.steps + 1)
    steps = np.unique(last_strides(run, shown, STRIDES, closed=True))
    shape = SavedShape(*(values[steps] for values in saved_shape(run)))
    nodes = shape.frame.shape[2]
    kept = np.linspace(0, nodes - 1, min(nodes, NODES)).round().astype(int)
    height = np.asarray(_height(run.prepared.model, run.prepared.numerics))
    axes = shape._replace(frame=shape.frame[:, :, kept]).axes()
    return {
        "times": np.round(1e3 * shape.t_s, 3).tolist(),
        "head": "head" if run.trial.support == "free" else "clamp",
        "position": packed(1e3 * shape.position_m[:, :, kept]),
        "b": packed(axes[:, 2]),
        "force": packed(_means(shape.force_N_per_m, kept)),
        "height": packed(1e3 * _means(height, kept)),
    }


@eqx.filter_jit
def _height(model: Model, numerics: Numerics) -> Array:
    """Returns the heights [m] of the cells."""
    height = make_mesh(model.body, numerics).structure.height
    return jnp.broadcast_to(height, numerics.tail_cells + numerics.body_cells)


def _means(cells: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Returns the means of values in cells (..., cells) between the nodes `kept`."""
    return np.add.reduceat(cells, kept[:-1], axis=-1) / np.diff(kept)


def packed(values: np.ndarray) -> dict[str, Any]:
    """Returns an array as base64 text of 16-bit integers, with the size of the unit.

    The rounding error is at most 1/65534 of the largest value.
    """
    unit = float(np.abs(values).max()) / 32767 or 1.0
    whole = np.round(values / unit).astype("<i2")
    return {
        "shape": list(values.shape),
        "unit": unit,
        "text": base64.b64encode(whole.tobytes()).decode(),
    }
