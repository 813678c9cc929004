"""The shape of a robot at every step of a trial: NPZ files, VTK files and Rerun recordings.

All vectors have three components. The motion of a planar robot has z = 0.
"""

import json
import zipfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from slider_jax.beam.spatial import Quaternion
from slider_jax.errors import InputError
from slider_jax.io.files import json_text, write_text
from slider_jax.simulation.trial import TrialRun

DEFINITIONS = {
    "t_s": "time (steps,), from the start of the trial",
    "midline_m": "positions of the nodes relative to the head (steps, 3, nodes), tail first; the "
    "axes are x, y (left) and z (upward)",
    "head_m": "position of the head in the tank (steps, 3); of a clamped robot 0",
    "frame": "quaternions w, x, y, z (steps, 4, nodes), which turn the axes x, y and z into the "
    "axes tau (towards the head), n and b of the section at a node",
    "moment_N_m": "bending moment about b at the nodes (steps, nodes); 0 at the first time",
    "force_N_per_m": "force of the water and of other effects per length, along x, y and z, in the "
    "cells between the nodes (steps, 3, cells); 0 at the first time",
}
INFO = "info"
"""Name of the array with inputs, settings and versions as JSON text."""

FRAMES = 11
"""Highest number of frames in a Rerun recording, so that the arrows do not hide the robot."""
FRAME_SIZE, FORCE_SIZE = 0.05, 0.2
"""Lengths of a frame's arrows, and of the largest force's arrow, divided by the robot's length."""


class SavedShape(NamedTuple):
    """The arrays of a shape file; `DEFINITIONS` gives their meaning."""

    t_s: np.ndarray
    midline_m: np.ndarray
    head_m: np.ndarray
    frame: np.ndarray
    moment_N_m: np.ndarray
    force_N_per_m: np.ndarray

    @property
    def position_m(self) -> np.ndarray:
        """Positions of the nodes in the tank (steps, 3, nodes) [m]."""
        return self.midline_m + self.head_m[:, :, None]

    def axes(self) -> np.ndarray:
        """Returns the vectors tau, n and b at the nodes (steps, axis, 3, nodes)."""
        # Indices of the array: axis of space, axis of the section, step, node.
        components: np.ndarray = np.array(Quaternion(*np.moveaxis(self.frame, 1, 0)).axes())
        return components.transpose(2, 1, 0, 3)


def saved_shape(run: TrialRun) -> SavedShape:
    """Returns the shape of a trial that was simulated with `shape=True`."""
    series = run.series
    still = np.zeros((len(run.t), 3))
    return SavedShape(
        run.t,
        _in_space(series["midline"]),
        _in_space(series["head"]) if "head" in series else still,
        series["frame"],
        series["moment"],
        _in_space(series["force"]),
    )


def _in_space(vectors: np.ndarray) -> np.ndarray:
    """Returns vectors (steps, 2 or 3, ...) with a third component, which is 0 in the plane."""
    lacking = 3 - vectors.shape[1]
    return np.pad(vectors, [(0, 0), (0, lacking)] + [(0, 0)] * (vectors.ndim - 2))


def write_shape(shape: SavedShape, info: dict[str, Any], path: Path) -> None:
    """Writes a shape file, with inputs, settings and versions in `info`."""
    text = json_text(info | {"definitions": DEFINITIONS})
    arrays: dict[str, Any] = shape._asdict() | {INFO: np.array(text)}
    np.savez_compressed(path, **arrays)


def read_shape(path: Path) -> tuple[SavedShape, dict[str, Any]]:
    """Returns the arrays and the inputs, settings and versions of a shape file.

    Raises `InputError` if the file is missing or is not a shape file.
    """
    advice = "give a file that `slider simulate --shape` wrote"
    try:
        with np.load(path, allow_pickle=False) as content:
            arrays = [content[name] for name in SavedShape._fields]
            info = json.loads(str(content[INFO]))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; {advice}") from None
    except KeyError as error:
        name = str(error.args[0]).split(" ")[0]
        raise InputError(f"{path}: no array {name}; {advice}") from None
    except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile):
        raise InputError(f"{path}: not a readable shape file (.npz); {advice}") from None
    shape = SavedShape(*arrays)
    steps, nodes = len(np.atleast_1d(shape.t_s)), np.shape(shape.midline_m)[-1:]
    sizes = (), (3, *nodes), (3,), (4, *nodes), nodes, (3, *(x - 1 for x in nodes))
    for name, values, size in zip(SavedShape._fields, shape, sizes, strict=True):
        if values.dtype.kind not in "iuf" or values.shape != (steps, *size):
            given = f"an array {values.shape} of type {values.dtype}"
            raise InputError.value(f"{path}, {name}", given, f"numbers {(steps, *size)}", advice)
    return shape, info


def write_vtk(shape: SavedShape, stem: str, folder: Path, every: int = 1) -> int:
    """Writes every `every`-th step as VTK file `<stem>_NNNNNN.vtp`, and the index `<stem>.pvd`.

    Each file contains the positions of the nodes in the tank, the moment and the vectors tau, n and
    b at the nodes, and the force per length in the cells. Returns the number of files. Source: VTK
    file formats, https://docs.vtk.org/en/latest/design_documents/VTKFileFormats.html.
    """
    axes, position, entries = shape.axes(), shape.position_m, []
    for i in range(0, len(shape.t_s), every):
        name = f"{stem}_{i:06d}.vtp"
        tau, n, b = axes[i]
        points = {"moment_N_m": shape.moment_N_m[i], "tau": tau, "n": n, "b": b}
        cells = {"force_N_per_m": shape.force_N_per_m[i]}
        write_text(folder / name, _polydata(position[i], points, cells))
        entries.append(f'<DataSet timestep="{shape.t_s[i]:.9g}" file="{name}"/>')
    write_text(folder / f"{stem}.pvd", _vtk_file("Collection", "\n".join(entries)))
    return len(entries)


def _vtk_file(kind: str, content: str) -> str:
    return (
        '<?xml version="1.0"?>\n'
        f'<VTKFile type="{kind}" version="0.1" byte_order="LittleEndian">\n'
        f"<{kind}>\n{content}\n</{kind}>\n</VTKFile>\n"
    )


def _data_array(name: str, values: np.ndarray, kind: str = "Float32") -> str:
    """Returns the XML of an array (nodes,) or (3, nodes)."""
    numbers = " ".join(format(x, ".7g") for x in np.ravel(values, order="F").tolist())
    size = f' NumberOfComponents="{len(values)}"' if values.ndim == 2 else ""
    return f'<DataArray type="{kind}" Name="{name}"{size} format="ascii">{numbers}</DataArray>'


def _polydata(position: np.ndarray, points: dict, cells: dict) -> str:
    """Returns the VTK file of a line of nodes (3, nodes), with a cell between two nodes."""
    nodes = position.shape[1]
    ends = np.stack([np.arange(nodes - 1), np.arange(1, nodes)])
    lines = [_data_array("connectivity", ends.T.ravel(), "Int64")]
    lines.append(_data_array("offsets", 2 * np.arange(1, nodes), "Int64"))
    content = [
        f'<Piece NumberOfPoints="{nodes}" NumberOfLines="{nodes - 1}">',
        "<Points>",
        _data_array("position_m", position),
        "</Points>\n<Lines>",
        *lines,
        "</Lines>\n<PointData>",
        *(_data_array(name, values) for name, values in points.items()),
        "</PointData>\n<CellData>",
        *(_data_array(name, values) for name, values in cells.items()),
        "</CellData>\n</Piece>",
    ]
    return _vtk_file("PolyData", "\n".join(content))


def write_rerun(shape: SavedShape, path: Path, every: int = 1) -> int:
    """Writes every `every`-th step to a Rerun recording (.rrd), and returns the number of steps.

    Entities: `robot/midline` is a line through the nodes in the tank. `robot/frames` has an arrow
    along tau, n and b at each of at most `FRAMES` nodes. `robot/forces` has an arrow in the middle
    of each cell, and the scale of the arrows. The timeline `time` is in seconds. Raises
    `InputError` if the package rerun-sdk is missing. Source: Rerun's columnar interface,
    https://rerun.io/docs/howto/logging-and-ingestion/send-columns.
    """
    try:
        import rerun as rr
    except ImportError:
        raise InputError(
            "--to rerun: the package rerun-sdk is not installed; install it with "
            "pip install -e .[rerun]"
        ) from None
    # Indices: step, node or cell, axis of space
    position = shape.position_m[::every].transpose(0, 2, 1)
    force = shape.force_N_per_m[::every].transpose(0, 2, 1)
    steps, nodes, _ = position.shape
    length = np.linalg.norm(np.diff(position[0], axis=0), axis=1).sum()
    largest = np.linalg.norm(force, axis=2).max()
    scale = FORCE_SIZE * length / largest if largest > 0.0 else 1.0
    shown = np.unique(np.linspace(0, nodes - 1, FRAMES).round().astype(int))
    # Indices: step, shown node, axis of the section, axis of space
    axes = FRAME_SIZE * length * shape.axes()[::every][..., shown].transpose(0, 3, 1, 2)
    origins = np.broadcast_to(position[:, shown, None], axes.shape)
    times = [rr.TimeColumn("time", duration=shape.t_s[::every])]

    recording = rr.RecordingStream("slider")
    recording.save(path)
    line = rr.LineStrips3D.columns(strips=list(position))
    recording.send_columns("robot/midline", times, line)

    def send_arrows(entity: str, vectors: np.ndarray, starts: np.ndarray, colors: list) -> None:
        columns = rr.Arrows3D.columns(vectors=vectors.reshape(-1, 3), origins=starts.reshape(-1, 3))
        many = [vectors[0].size // 3] * steps
        recording.log(entity, rr.Arrows3D.from_fields(colors=colors), static=True)
        recording.send_columns(entity, times, columns.partition(many))

    red, green, blue, orange = [230, 60, 60], [60, 170, 60], [60, 90, 230], [240, 140, 20]
    send_arrows("robot/frames", axes, origins, [red, green, blue] * len(shown))
    send_arrows("robot/forces", scale * force, (position[:, 1:] + position[:, :-1]) / 2, [orange])
    recording.log("robot/forces", rr.AnyValues(metres_per_N_per_m=scale), static=True)
    recording.flush()
    recording.disconnect()
    return steps
