"""Detects heavy-tailed noise in whitened residuals, and the weights of a robust fit.

Noise with heavy tails has more large errors than normal noise. The model of such noise is Student's
t-distribution. A least-squares fit with the weights w = (nu + 1)/(nu + z^2) of the standardised
residuals z maximises its likelihood. Source: Lange, K. L., Little, R. J. A. and Taylor, J. M. G.
(1989), J. Am. Stat. Assoc. 84, 881-896.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import norm, t as student

MAX_FREEDOM = 10.0
"""Noise with at least this number of degrees of freedom is treated as normal. A least-squares fit
to such noise loses at most 6 % of the information."""
MIN_RATIO = 20.0
"""Tails count as heavy only if the doubled log-likelihood ratio of Student's t against the normal
distribution exceeds this value. The largest ratio of 300 series of normal noise was 8."""
MAX_SQUARE = 3.0
"""A channel keeps normal noise if the mean square of its whitened residual is not below this value.
Its large errors may come from a missing effect."""


class Tails(NamedTuple):
    """Student's t-distribution of whitened residuals."""

    freedom: float
    scale: float

    @property
    def mean_square(self) -> float:
        """Returns the expected mean square of noise that is whitened by `variances`."""
        return (self.freedom + 1.0) / (self.freedom + 3.0)

    def variances(self, white: np.ndarray) -> np.ndarray:
        """Returns the variances (n,) with which a least-squares fit weights the residuals `white`.

        Each variance is a multiple of the variance that whitened the residual. The Fisher
        information of Student's t is (nu + 1)/(nu + 3) times the mean weight. The variances contain
        this factor, so that the covariance of the fit is correct.
        """
        nu, z = self.freedom, white / self.scale
        return self.scale**2 * (nu + 3.0) / (nu + 1.0) * (nu + z**2) / (nu + 1.0)


def student_tails(x: np.ndarray) -> tuple[Tails, float]:
    """Returns the most likely Student distribution of x (n,), and the doubled log-likelihood ratio.

    The ratio compares this distribution with the most likely normal distribution of mean zero.
    """

    def scale_of(nu: float) -> float:
        square = float(np.mean(x**2))
        for _ in range(50):
            square = float(np.mean((nu + 1.0) * x**2 / (nu + x**2 / square)))
        return float(np.sqrt(square))

    def loss(log_nu: float) -> float:
        nu = float(np.exp(log_nu))
        return -float(np.sum(student.logpdf(x, nu, scale=scale_of(nu))))

    best = minimize_scalar(loss, bounds=(np.log(1.0), np.log(100.0)), method="bounded")
    nu = float(np.exp(best.x))
    normal = float(np.sum(norm.logpdf(x, scale=np.sqrt(np.mean(x**2)))))
    return Tails(nu, scale_of(nu)), 2.0 * (-float(best.fun) - normal)


def heavy_tails(residuals: Mapping[tuple[int, str], np.ndarray]) -> dict[str, Tails]:
    """Returns the tails of the channels with heavy-tailed noise; `residuals` are whitened.

    Two series must have heavy tails: the residual, and the deviation of each residual from the mean
    of its two neighbours. A missing effect causes a smooth residual, which hardly changes this
    deviation.
    """
    found = {}
    for channel in dict.fromkeys(name for _, name in residuals):
        series = [r for (_, name), r in residuals.items() if name == channel and len(r) > 2]
        if not series or not np.mean(np.concatenate(series) ** 2) < MAX_SQUARE:
            continue
        tails, ratio = student_tails(_pooled(series))
        _, sharp = student_tails(_pooled([x[1:-1] - 0.5 * (x[:-2] + x[2:]) for x in series]))
        if min(ratio, sharp) > MIN_RATIO and tails.freedom < MAX_FREEDOM:
            size = float(np.sqrt(np.mean(np.concatenate(series) ** 2)))
            # Tails never explain a residual above the noise, so the scale is at most 1.
            found[channel] = tails._replace(scale=min(size * tails.scale, 1.0))
    return found


def _pooled(series: Sequence[np.ndarray]) -> np.ndarray:
    """Returns all series, each divided by its rms: different sizes would look like heavy tails."""
    return np.concatenate([x / max(float(np.sqrt(np.mean(x**2))), 1e-300) for x in series])
