"""What a search has found: its rounds, and what was tried in each."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.stats import wilcoxon

from calibration.discrepancy.scores import Score
from calibration.inference.gauss_newton import Fit
from calibration.model.extended import Parameter
from slider_jax.channels import CHANNELS, row_of

LEAST_GAIN = 20.0
"""Smallest gain of a refitted candidate that counts, in units of the residual's mean square."""
SHARE = 0.5
"""A candidate is refitted if its score is at least so much of the best one's."""
AGREE = 2.0
"""Mean over the left-out trials of what `Score.left_out` says, over its standard error, from which
on they agree, beside a gain beyond chance: were it all, 6 % of chance with five trials and 9 % with
three. Factors are averaged, not drops: a trial that is far off has no greater say."""
UNALIKE = 0.07
"""They agree as well where Wilcoxon's signed ranks say so, at this probability of chance: where all
improve, four of four or more, but some by far more than others."""


class Agreement(NamedTuple):
    """Whether trials that were left out foresaw a candidate's gain on each other."""

    mean: float
    """Mean of `Score.left_out` over its standard error."""
    chance: float
    """Probability of their signed ranks by chance."""

    @property
    def agreed(self) -> bool:
        return bool(self.mean > AGREE or self.chance < UNALIKE)


def agreement(left_out: np.ndarray) -> Agreement:
    """Of the logarithms `Score.left_out` (trials,)."""
    n = len(left_out)
    spread = float(left_out.std(ddof=1)) / np.sqrt(n) if n > 1 else np.inf
    mean = float(left_out.mean()) / max(spread, 1e-300)
    return Agreement(mean, float(wilcoxon(left_out, alternative="greater").pvalue))


@dataclass(frozen=True)
class Refit:
    """A candidate that was refitted jointly with everything before it."""

    name: str
    fit: Fit
    gain: float
    """Drop of the sum of squares, in units of its own mean square."""
    sizes: dict[str, float]
    """rms of what it changes in each channel, as a share of the channel's rms."""
    agreement: Agreement

    @property
    def worth_naming(self) -> bool:
        return worth_naming(self.gain, self.sizes)


def worth_naming(gain: float, sizes: dict[str, float]) -> bool:
    """Whether an effect of so much gain changes some channel by so much that it is to be named."""
    return gain > LEAST_GAIN and any(sizes[c] > CHANNELS[c].discrepancy for c in sizes)


class Alternative(NamedTuple):
    """The last fit of a search with a rival in the place of what was chosen."""

    fit: Fit
    loss: float
    """By how much the sum of squares is larger, in units of the last fit's mean square."""
    sizes: dict[str, float]
    """rms of what the two fits differ by in each channel, as a share of the channel's rms."""

    @property
    def is_worse(self) -> bool:
        return worth_naming(self.loss, self.sizes)

    @property
    def is_better(self) -> bool:
        return worth_naming(-self.loss, self.sizes)


@dataclass
class SelectionStep:
    """One round of the search."""

    scores: list[Score]
    tried: list[Refit] = field(default_factory=list)
    chosen: str | None = None
    alike: list[str] = field(default_factory=list)
    """Names that cannot be told from the chosen one."""
    rivals: dict[str, Alternative] = field(default_factory=dict)
    """Those that were judged at the end, in the class or not."""
    taken_out: str | None = None
    """What was chosen, until a later round left it nothing to explain."""
    replaced: str | None = None
    """What was chosen, until a rival took its place."""


@dataclass
class Selection:
    """The whole search: the fit of the base model, the rounds, and the last fit."""

    base: Fit
    final: Fit
    effects: list[str]
    rounds: list[SelectionStep]


def groups(entries: Sequence[Parameter]) -> dict[str, np.ndarray]:
    """Indices of every effect's parameters."""
    names = dict.fromkeys(p.effect for p in entries if p.effect)
    return {n: np.array([i for i, p in enumerate(entries) if p.effect == n]) for n in names}


def scored(entries: Sequence[Parameter]) -> dict[str, np.ndarray]:
    """Indices of every effect's parameters by which it is scored: those with a start, or all."""
    found = {}
    for name, group in groups(entries).items():
        begun = [i for i in group if entries[i].prior.start is not None]
        found[name] = np.array(begun) if begun else group
    return found


def relative_changes(
    channels: Sequence[str], before: Sequence[np.ndarray], after: Sequence[np.ndarray]
) -> dict[str, float]:
    """rms of the change in every channel over its rms, all trials (5, samples) together."""
    found = {}
    for channel in channels:
        row = row_of(channel)
        change = np.concatenate([b[row] - a[row] for a, b in zip(before, after, strict=True)])
        signal = np.concatenate([a[row] for a in before])
        found[channel] = float(np.sqrt(np.mean(change**2) / max(np.mean(signal**2), 1e-300)))
    return found
