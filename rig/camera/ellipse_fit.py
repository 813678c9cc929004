"""Fits a blurred, partly hidden disc to the visible pixels of a marker by least squares."""

from typing import NamedTuple

import numpy as np

MAX_STEPS = 40
SOFTEST, SHARPEST = 1.5, 60.0
"""Bounds of the edge's sharpness k. Outside these bounds, k hardly changes the image."""


class SoftEllipse(NamedTuple):
    """Marker with a soft edge: m(p) = b + A / (1 + exp(k (|u| - 1))), with u = S (p - c).

    m is the value at the pixel p [px], c = (x, y) [px] the centre, A the amplitude, b the
    background, and k the sharpness of the edge. S [1/px] is an upper triangular matrix.
    """

    x: float
    y: float
    s_xx: float
    s_xy: float
    s_yy: float
    k: float
    amplitude: float
    background: float

    @property
    def mass(self) -> float:
        """Integral of m - b over the image [px^2], which motion blur does not change."""
        return self.amplitude * np.pi * (1 + np.pi**2 / (3 * self.k**2)) / (self.s_xx * self.s_yy)

    def inside(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Returns True for each pixel inside the ellipse, where |u| < 1."""
        dx, dy = x - self.x, y - self.y
        return np.hypot(self.s_xx * dx + self.s_xy * dy, self.s_yy * dy) < 1


def initial_ellipse(center: np.ndarray, covariance: np.ndarray, mass: float) -> SoftEllipse:
    """Returns the ellipse with the given moments, which is the initial estimate of the fit."""
    inverse = np.linalg.inv(4 * covariance)  # a uniform ellipse ends where p' C^-1 p = 4
    s_xx = np.sqrt(inverse[0, 0])
    s_xy = inverse[0, 1] / s_xx
    s_yy = np.sqrt(inverse[1, 1] - s_xy**2)
    amplitude = mass * s_xx * s_yy / np.pi
    return SoftEllipse(center[0], center[1], s_xx, s_xy, s_yy, 8.0, amplitude, 0.0)


def ellipse_model(q: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns m (n,) at pixels (n,), and its derivatives (n, 8) by q, a `SoftEllipse`'s fields."""
    cx, cy, s_xx, s_xy, s_yy, k, amplitude, background = q
    dx, dy = x - cx, y - cy
    u, v = s_xx * dx + s_xy * dy, s_yy * dy
    rho = np.sqrt(u * u + v * v + 1e-12)
    level = 1 / (1 + np.exp(np.clip(k * (rho - 1), -50, 50)))
    by_edge = amplitude * level * (level - 1)
    by_u, by_v = by_edge * k * u / rho, by_edge * k * v / rho
    slopes = (
        -s_xx * by_u, -s_xy * by_u - s_yy * by_v,
        dx * by_u, dy * by_u, dy * by_v,
        by_edge * (rho - 1), level, np.ones_like(level),
    )  # fmt: skip
    return background + amplitude * level, np.stack(slopes, axis=1)


def fit_ellipse(
    x: np.ndarray, y: np.ndarray, values: np.ndarray, start: SoftEllipse
) -> tuple[SoftEllipse, float] | None:
    """Fits an ellipse to the filled fractions `values` (n,) of pixels by Levenberg-Marquardt.

    Returns the ellipse and the centre's standard error [px], or None if the fit does not converge.
    """
    q, damping = np.array(start), 1e-3
    found, slopes = ellipse_model(q, x, y)
    cost = np.sum((values - found) ** 2)
    for _ in range(MAX_STEPS):
        normal = slopes.T @ slopes
        size = np.sqrt(np.diag(normal)) + 1e-9
        damped = normal / np.outer(size, size) + damping * np.eye(len(q))
        step = np.linalg.solve(damped, slopes.T @ (values - found) / size) / size
        trial = q + step
        trial[5] = np.clip(trial[5], SOFTEST, SHARPEST)
        if trial[2] > 0 and trial[4] > 0:
            new, new_slopes = ellipse_model(trial, x, y)
            new_cost = np.sum((values - new) ** 2)
            if new_cost <= cost:
                converged = np.hypot(step[0], step[1]) < 1e-3 and cost - new_cost < 1e-4 * cost
                q, found, slopes, cost = trial, new, new_slopes, new_cost
                damping = max(damping / 10, 1e-9)
                if converged:
                    break
                continue
        damping *= 10
        if damping > 1e9:
            return None
    else:
        return None
    normal = slopes.T @ slopes
    variance = np.diag(np.linalg.pinv(normal))[:2] * cost / max(len(values) - 8, 1)
    return SoftEllipse._make(q.tolist()), float(np.sqrt(variance.sum()))
