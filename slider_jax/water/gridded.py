"""Velocity field of the water on a grid, and the NPZ file that contains it."""

import itertools
import math
import zipfile
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slider_jax.errors import InputError
from slider_jax.water.base import WaterField

AXES = ("t_s", "y_m", "x_m")
"""Arrays of a file with the axes of the velocities, in their order."""
VELOCITIES = ("u_m_per_s", "v_m_per_s")
"""Arrays of a file with the velocities along x and y."""
PERIOD = "period_s"
"""Optional number of a file: the period [s] after which the field repeats."""
FASTEST = 3.0
"""Largest plausible speed [m/s] of the water."""


class GriddedField(WaterField):
    """Velocities on an evenly spaced grid in t, y and x, with cubic convolution between the points.

    The velocity and its slopes are continuous. The error is of third order in the spacing, and of
    second order in the cells at the edges. Linear fields are exact. Outside the grid, the velocity
    is NaN, so a simulated step does not converge there. The interpolation does not conserve volume
    exactly. Source: Keys, R. G. (1981), Cubic convolution interpolation for digital image
    processing, IEEE Trans. Acoust. Speech Signal Process. 29, 1153-1160.
    """

    values: Float[Array, "2 t y x"]
    """Velocities (x, y) [m/s]. Each axis has one extrapolated point before the grid and one or, for
    a periodic field in t, two points behind the grid."""
    start: Float[Array, "3"]
    """First t [s], y [m] and x [m] of the grid."""
    spacing: Float[Array, "3"]
    """Spacing [s, m, m] of the grid."""
    periodic: bool = eqx.field(static=True)
    """Whether the field repeats in time. A steady field has one time and is periodic."""

    @property
    def ends(self) -> dict[str, tuple[float, float]]:
        """First and last value of each axis of the grid, by the name of the array in a file."""
        last = self.start + self.spacing * (jnp.asarray(self.values.shape[1:], float) - 3.0)
        return {
            name: (float(a), float(b)) for name, a, b in zip(AXES, self.start, last, strict=True)
        }

    def velocity(self, place, t):
        u = (jnp.stack([t, place[1], place[0]]) - self.start) / self.spacing
        counts = self.values.shape[1:]
        if self.periodic:
            u = u.at[0].set(jnp.mod(u[0], counts[0] - 3.0))
        last = jnp.asarray(counts, float) - 3.0
        inside = jnp.all((u >= -1e-9) & (u <= last + 1e-9))
        u = jnp.clip(u, 0.0, last)
        cell = jnp.minimum(jnp.floor(u), jnp.maximum(last - 1.0, 0.0))
        weights = _weights(u - cell)
        first = cell.astype(int)
        U = sum(
            weights[a, 0] * weights[b, 1] * weights[c, 2]
            * self.values[:, first[0] + a, first[1] + b, first[2] + c]
            for a, b, c in itertools.product(range(4), repeat=3)
        )  # fmt: skip
        return jnp.where(inside, U, jnp.nan)


def _weights(u: Float[Array, "3"]) -> Float[Array, "4 3"]:
    """Returns the weights of the points -1, 0, 1 and 2 at the places 0 <= u <= 1 (Keys 1981)."""
    return 0.5 * jnp.stack(
        [
            u * (-1.0 + u * (2.0 - u)),
            2.0 + u * u * (3.0 * u - 5.0),
            u * (1.0 + u * (4.0 - 3.0 * u)),
            u * u * (u - 1.0),
        ]
    )


def gridded(
    t: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    u: np.ndarray,
    v: np.ndarray,
    period: float | None = None,
    where: str = "velocity field",
) -> GriddedField:
    """Returns the field with the velocities `u`, `v` (t, y, x) [m/s] at `t` [s] and `x`, `y` [m].

    With one time, the field is steady. With `period` [s], the field repeats; the times must cover
    one period evenly, without the end of the period. Raises `InputError` for an axis that is not
    increasing and evenly spaced, for a wrong shape, for a value that is not finite, and for a speed
    above 3 m/s. Messages begin with `where`.
    """
    axes = dict(zip(AXES, (np.asarray(a, float) for a in (t, y, x)), strict=True))
    for name, axis in axes.items():
        if axis.ndim != 1 or axis.size < (1 if name == "t_s" else 2):
            least = "one or more times" if name == "t_s" else "two or more places"
            raise InputError.value(f"{where}, {name}", f"the shape {axis.shape}", least)
        steps = np.diff(axis)
        if not np.all(np.isfinite(axis)) or np.any(steps <= 0.0):
            raise InputError.value(
                f"{where}, {name}", "values that do not increase", "increasing finite numbers"
            )
        if steps.size and np.ptp(steps) > 1e-3 * steps.mean():
            raise InputError.value(
                f"{where}, {name}",
                f"spacings from {steps.min():g} to {steps.max():g}",
                "evenly spaced values",
                "interpolate the field to an even grid",
            )
    shape = tuple(axis.size for axis in axes.values())
    both = [np.asarray(a, float) for a in (u, v)]
    for name, values in zip(VELOCITIES, both, strict=True):
        if values.shape != shape:
            raise InputError.value(
                f"{where}, {name}", f"the shape {values.shape}",
                f"{shape}, the numbers of values in t_s, y_m and x_m",
            )  # fmt: skip
        if not np.all(np.isfinite(values)):
            at = np.argwhere(~np.isfinite(values))[0]
            raise InputError.value(
                f"{where}, {name}", f"{values[tuple(at)]} at the index {at.tolist()}",
                "finite numbers", "fill gaps of the measurement by interpolation",
            )  # fmt: skip
    fastest = float(np.max(np.hypot(*both)))
    if fastest > FASTEST:
        raise InputError.value(
            f"{where}, {' and '.join(VELOCITIES)}", f"a speed of {fastest:g}",
            f"at most {FASTEST:g} m/s", "speeds are in metres per second",
        )  # fmt: skip
    first = np.array([axis[0] for axis in axes.values()])
    spacing = np.array([np.ptp(a) / (a.size - 1) if a.size > 1 else 1.0 for a in axes.values()])
    periodic = period is not None or shape[0] == 1
    if period is not None:
        if shape[0] == 1:
            spacing[0] = period
        if not math.isclose(shape[0] * spacing[0], period, rel_tol=1e-3):
            raise InputError.value(
                f"{where}, {PERIOD}", f"{period:g} s",
                f"{shape[0] * spacing[0]:g} s, the number of times multiplied by their spacing",
            )  # fmt: skip
        spacing[0] = period / shape[0]
    values, in_time = np.stack(both), 1
    if periodic:
        values = np.pad(values, [(0, 0), (1, 2), (0, 0), (0, 0)], mode="wrap")
        in_time = 0
    pad = [(0, 0), (in_time, in_time), (1, 1), (1, 1)]
    values = np.pad(values, pad, mode="reflect", reflect_type="odd")
    return GriddedField(jnp.asarray(values), jnp.asarray(first), jnp.asarray(spacing), periodic)


def read_field(path: Path | str) -> GriddedField:
    """Returns the field of the NPZ file `path`, which NumPy writes with `numpy.savez`.

    The file contains the arrays t_s (t,), x_m (x,), y_m (y,), u_m_per_s and v_m_per_s (t, y, x),
    and optionally the number period_s; see `gridded`. Raises `InputError` if the file is missing or
    invalid.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            content = np.load(file, allow_pickle=False)
            if not isinstance(content, np.lib.npyio.NpzFile):
                raise ValueError("an array, not an archive")
            arrays = {name: content[name] for name in content.files}
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; give the name of an NPZ file") from None
    except (OSError, ValueError, EOFError, zipfile.BadZipFile):
        raise InputError(
            f"{path}: cannot be read as an NPZ file of numbers; write it with numpy.savez"
        ) from None
    needed = ("t_s", "x_m", "y_m", *VELOCITIES)
    missing = [name for name in needed if name not in arrays]
    unknown = [name for name in arrays if name not in (*needed, PERIOD)]
    if missing or unknown:
        given = f"no array {missing[0]}" if missing else f"unknown array {unknown[0]}"
        raise InputError(f"{path}: {given}; allowed {', '.join(needed)}, and optionally {PERIOD}")
    for name, values in arrays.items():
        if values.dtype.kind not in "iuf":
            raise InputError.value(f"{path}, {name}", f"the type {values.dtype}", "numbers")
    period = None
    if PERIOD in arrays:
        if arrays[PERIOD].size != 1 or not arrays[PERIOD].item() > 0.0:
            raise InputError.value(f"{path}, {PERIOD}", arrays[PERIOD], "one positive number")
        period = float(arrays[PERIOD].item())
    t, x, y, u, v = (arrays[name] for name in needed)
    return gridded(t, x, y, u, v, period, str(path))
