"""A fitting problem whose readings are sums of known series."""

from types import SimpleNamespace

import numpy as np

from calibration.inference.noise import Noise
from calibration.measurements.records import Record
from slider_jax.channels import SLIDER_CHANNELS

TRIALS, SAMPLES = 4, 300

SHAPES = np.random.default_rng(1).normal(size=(5, TRIALS, SAMPLES))

SHAPES[2] = SHAPES[4] + 0.25 * SHAPES[3] + 0.1 * SHAPES[2]


class Sums:
    """Readings are parameters times `shapes` (parameters, trials, samples), plus noise."""

    channels = ("tip",)
    all_channels = SLIDER_CHANNELS
    maps = memo = None
    mesh_ratio, discrepancies = 1.0, {"tip": 0.005}

    def __init__(self, truth, shapes=SHAPES, noise=0.1, seed=0):
        self.shapes, self.size = shapes, 1.0 / noise
        noise = np.random.default_rng(seed).normal(size=(TRIALS, SAMPLES))
        self.y = self._sum(np.asarray(truth)) + noise
        t, values = 0.01 * np.arange(SAMPLES), np.zeros((5, SAMPLES))
        self.records = [
            Record(SimpleNamespace(file=str(i)), t, values, SLIDER_CHANNELS) for i in range(TRIALS)
        ]
        self.noise = {(i, "tip"): Noise(1.0) for i in range(TRIALS)}

    def _sum(self, theta):
        return self.size * np.tensordot(theta, self.shapes, 1)

    def predict(self, theta):
        found = np.zeros((TRIALS, 5, SAMPLES))
        found[:, 4] = self._sum(theta)
        return list(found)

    def tangents(self, theta, directions):
        found = np.zeros((TRIALS, len(directions), 5, SAMPLES))
        found[:, :, 4] = self.size * np.einsum("kp,pts->tks", directions, self.shapes)
        return list(found)

    def whiteners(self, predicted):
        return {}

    def residuals(self, predicted, white):
        return {(i, "tip"): self.y[i] - predicted[i][4] for i in range(TRIALS)}

    def on_coarse_mesh(self):
        return self

    def coarse(self, thetas):
        return [np.stack(x) for x in zip(*(self.predict(theta) for theta in thetas), strict=True)]

    def secants(self, theta, others):
        return [y[1:] - y[:1] for y in self.coarse([theta, *others])]

    def whitened(self, changes, white, in_place=False):
        found = {(i, "tip"): x[:, 4].copy() for i, x in enumerate(changes)}
        if in_place:  # the content is lost
            for x in changes:
                x[...] = np.nan
        return found
