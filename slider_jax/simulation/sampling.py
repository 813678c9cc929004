"""From the steps of a rollout to the times of a record, without smearing the switching edges."""

import numpy as np


def half_period_steps(frequency: float, longest: float, phase: float = 0.0) -> int:
    """Steps per half period of 1/`frequency` [Hz], none longer than `longest` [s].

    The front chamber switches at whole half periods, which are on steps by construction. Where up
    to a quarter more steps put the rear chamber's edges, `phase` of a period later, on steps too,
    they are taken.
    """
    least = max(2, int(np.ceil(0.5 / (frequency * longest) * (1.0 - 1e-12))))
    for steps in range(least, least + least // 4 + 1):
        if abs(2 * steps * phase - round(2 * steps * phase)) < 1e-6:
            return steps
    return least


def edge_steps(steps: int, half_period: int, phase: float = 0.0) -> np.ndarray:
    """Indices of steps, 0 and `steps` included, between which the drive is smooth."""
    delay = round(2 * half_period * phase) % half_period
    edges = np.concatenate(
        [np.arange(0, steps, half_period), np.arange(delay, steps, half_period), [0, steps]]
    )
    return np.unique(edges)


def nearest_steps(steps: int, h: float, times: np.ndarray) -> np.ndarray:
    """As `edge_steps`, for edges at any `times` [s]: each is put on the nearest step of `h`."""
    near = np.round(np.asarray(times) / h).astype(int)
    return np.unique(np.concatenate([near[(near > 0) & (near < steps)], [0, steps]]))


def sample(t: np.ndarray, values: np.ndarray, at: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Cubic interpolation of `values` (n, ...) at evenly spaced `t` (n,) to the times `at`.

    Each time takes the four nearest steps between two neighbouring `edges` (indices into t), so
    that no polynomial crosses an edge; a shorter stretch takes the steps that it has.
    """
    h = (t[-1] - t[0]) / (len(t) - 1)
    place = np.clip((at - t[0]) / h, 0.0, len(t) - 1.0)
    cell = np.minimum(place.astype(int), len(t) - 2)
    stretch = np.clip(np.searchsorted(edges, cell, side="right") - 1, 0, len(edges) - 2)
    low, high = edges[stretch], edges[stretch + 1]
    first = np.maximum(np.minimum(cell - 1, high - 3), low)
    count = np.minimum(high - first + 1, 4)
    result = np.zeros((len(at), *values.shape[1:]))
    for i in range(4):
        weight = np.where(i < count, 1.0, 0.0)
        for j in range(4):
            if i != j:
                factor = (place - first - j) / (i - j)
                weight = weight * np.where(j < count, factor, 1.0)
        node = np.minimum(first + i, len(t) - 1)
        result += weight.reshape(-1, *[1] * (values.ndim - 1)) * values[node]
    return result
