"""What the data say of a parameter vector: white residuals and tangents, as small matrices.

Of every trial and channel, with the white residual r and tangents J (parameters, m):

    A = J J^T,    b = J r,    c = r.r,    n samples

Least squares, scores, left-out trials and classes of effects all follow from sums of these, so that
simulation is done once for each vector and never again for a question asked of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calibration.forward import (
    CHANNELS,
    COARSE,
    FINE,
    Resolution,
    TrialPlan,
    on_all_cores,
    plan,
    predict,
    tangents,
)
from calibration.measured import Record
from calibration.noise import Noise, Whitener, declared
from slider_jax.experiment import Experiment

FAILED = 1e12
"""Sum of squares of a channel whose simulation failed: worse than any that did not."""


class Block(NamedTuple):
    """One trial and channel at one vector."""

    trial: int
    channel: str
    A: np.ndarray
    b: np.ndarray
    c: float
    n: int


def summed(blocks: Sequence[Block]) -> tuple[np.ndarray, np.ndarray]:
    """A and b of all blocks."""
    return np.sum([x.A for x in blocks], axis=0), np.sum([x.b for x in blocks], axis=0)


@dataclass(frozen=True)
class Problem:
    """Measured trials and the plans to predict them."""

    records: list[Record]
    fine: list[TrialPlan]
    coarse: list[TrialPlan]
    channels: tuple[str, ...]
    noise: dict[tuple[int, str], Noise]

    @classmethod
    def of(
        cls,
        experiment: Experiment,
        records: list[Record],
        effects: tuple[str, ...],
        channels: tuple[str, ...] = CHANNELS,
        fine: Resolution = FINE,
        coarse: Resolution = COARSE,
    ) -> "Problem":
        """Lay out `records` of an experiment for the extended model with `effects`."""
        plans = [
            [plan(experiment, r.trial, effects, resolution, r.t) for r in records]
            for resolution in (fine, coarse)
        ]
        noise = {
            (i, channel): declared(experiment.sensors, channel, r.values[CHANNELS.index(channel)])
            for i, r in enumerate(records)
            for channel in channels
            if r.has(channel)
        }
        return cls(records, plans[0], plans[1], channels, noise)

    def predict(self, theta: np.ndarray) -> list[np.ndarray]:
        """Readings (5, samples) of every trial."""
        return on_all_cores(lambda p: predict(p, theta), self.fine)

    def tangents(self, theta: np.ndarray, directions: np.ndarray) -> list[np.ndarray]:
        """Derivatives (k, 5, samples) of every trial."""
        return on_all_cores(lambda p: tangents(p, theta, directions), self.coarse)

    def whiteners(self, predicted: list[np.ndarray]) -> dict[tuple[int, str], Whitener]:
        """Of every trial and channel; what is a share of the signal is of the `predicted` one."""

        def one(key):
            i, channel = key
            there = self.records[i].there(channel)
            model = predicted[i][CHANNELS.index(channel)][there]
            return key, Whitener(self.records[i].t[there], self.noise[key], model, channel)

        return dict(on_all_cores(one, list(self.noise)))

    def residuals(
        self, predicted: list[np.ndarray], white: dict[tuple[int, str], Whitener]
    ) -> dict[tuple[int, str], np.ndarray]:
        """White residuals, measured less predicted, of every trial and channel."""
        found = {}
        for key, whiten in white.items():
            i, channel = key
            row, there = CHANNELS.index(channel), self.records[i].there(channel)
            found[key] = whiten((self.records[i].values[row] - predicted[i][row])[there])[0]
        return found

    def blocks(
        self,
        residuals: dict[tuple[int, str], np.ndarray],
        derivatives: list[np.ndarray],
        white: dict[tuple[int, str], Whitener],
    ) -> list[Block]:
        """The matrices of every trial and channel."""
        found = []
        for key, r in residuals.items():
            i, channel = key
            there = self.records[i].there(channel)
            J = white[key](derivatives[i][:, CHANNELS.index(channel), there])
            found.append(Block(i, channel, J @ J.T, J @ r, float(r @ r), len(r)))
        return found


def total(residuals: dict[tuple[int, str], np.ndarray]) -> float:
    """Sum of squares of all white residuals; failed ones count as `FAILED`."""
    parts = [float(r @ r) for r in residuals.values()]
    return sum(x if np.isfinite(x) else FAILED for x in parts)
