"""The result files of `slider statics`."""

from pathlib import Path
from typing import Any

import numpy as np

from slider_jax.io.figures import new_figure, save_figure
from slider_jax.io.files import input_files, provenance, write_csv, write_json
from slider_jax.rod.equilibrium import NEUTRAL, RodEquilibrium
from slider_jax.rod.rod import rod_shape
from slider_jax.statics.case import StaticCase


def result_of(found: RodEquilibrium, eigenvalue: float) -> dict[str, Any]:
    """Returns the result of an equilibrium as in statics.json, without settings.

    All forces and moments are those that the rod exerts on its supports.
    """
    return {
        "tip_m": np.asarray(found.shape.position[-1]).tolist(),
        "tip_frame": np.asarray(found.shape.frame[-1]).T.tolist(),
        "clamp_force_N": np.asarray(found.force).tolist(),
        "clamp_moment_N_m": np.asarray(found.moment).tolist(),
        "end_force_N": (0.0 - np.asarray(found.end_force)).tolist(),
        "end_moment_N_m": (0.0 - np.asarray(found.end_moment)).tolist(),
        "residual": float(found.residual),
        "stable": eigenvalue > -NEUTRAL,
        "smallest_eigenvalue": eigenvalue,
    }


def write_statics(case: StaticCase, found: RodEquilibrium, eigenvalue: float, folder: Path) -> None:
    """Writes statics.json, shape.csv and shape.png to `folder`."""
    settings = case.table.model_dump(mode="json")
    files = {"input": input_files(*case.files), "settings": settings} | provenance()
    write_json(folder / "statics.json", result_of(found, eigenvalue) | files)
    s = np.concatenate([[0.0], np.cumsum(np.asarray(case.rod.ds))[1::2]])
    position = np.asarray(found.shape.position)
    columns = dict(zip(("s_m", "x_m", "y_m", "z_m"), (s, *position.T), strict=True))
    write_csv(folder / "shape.csv", columns, {})
    unloaded = np.asarray(rod_shape(case.rod, case.rod.unloaded).position)
    _draw(case.table.name, unloaded, position, folder / "shape.png")


def _draw(name: str, unloaded: np.ndarray, loaded: np.ndarray, path: Path) -> None:
    """Draws both shapes in space and in three projections, with equal scales of the axes."""
    figure, axes = new_figure(1, 3, figsize=(11.0, 4.0))
    for ax, (i, j) in zip(axes, ((0, 1), (0, 2), (1, 2)), strict=True):
        ax.plot(unloaded[:, i], unloaded[:, j], "0.7", label="without loads")
        ax.plot(loaded[:, i], loaded[:, j], "C0", label="with loads")
        ax.plot(*loaded[0, [i, j]], "ks", markersize=4)
        ax.set_xlabel(f"{'xyz'[i]} (m)")
        ax.set_ylabel(f"{'xyz'[j]} (m)")
        ax.set_aspect("equal", adjustable="datalim")
        ax.grid(alpha=0.3)
    axes[0].legend()
    figure.suptitle(name)
    save_figure(figure, path)
