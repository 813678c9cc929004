"""Defines the record of a selection: rounds, refitted candidates and alternatives."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.stats import t as student, wilcoxon

from calibration.discrepancy.scores import Score
from calibration.discrepancy.settings import DEFAULT_SETTINGS, SelectionSettings
from calibration.inference.gauss_newton import Fit
from calibration.inference.measured_discrepancy import Discrepancy
from calibration.inference.problem import AbstractProblem
from calibration.model.extended import Parameter
from slider_jax.effects import Prior
from slider_jax.effects.library import LIBRARY


class Agreement(NamedTuple):
    """Result of cross-validation: whether a candidate improves predictions of held-out trials."""

    t: float
    """Mean of the log gains `Score.left_out`, divided by the mean's standard error."""
    t_chance: float
    """p-value of the t-test on these log gains; 1 for fewer than three trials."""
    rank_chance: float
    """p-value of Wilcoxon's signed-rank test on these log gains."""
    least_gain: float
    """Smallest of the gains `Score.held_gains`; -inf for fewer than two trials."""
    rest_gain: float = -np.inf
    """Sum of these gains without the largest; -inf for fewer than two trials."""

    def agreed(self, settings: SelectionSettings = DEFAULT_SETTINGS) -> bool:
        """Returns whether cross-validation confirms the candidate."""
        return bool(
            self.t_chance < settings.left_out_p
            or self.rank_chance < settings.wilcoxon_p
            or self.least_gain > settings.least_held_gain
            or (
                self.rest_gain > settings.least_rest_gain
                and self.least_gain > -settings.most_loss_share * self.rest_gain
            )
        )


def agreement(left_out: np.ndarray, held_gains: np.ndarray) -> Agreement:
    """Returns the result of cross-validation from log gains and gains (trials,) of a `Score`."""
    n = len(left_out)
    if not np.any(left_out):  # the candidate changes no trial
        return Agreement(0.0, 1.0, 1.0, -np.inf, -np.inf)
    spread = float(left_out.std(ddof=1)) / np.sqrt(n) if n > 1 else np.inf
    t = float(left_out.mean()) / max(spread, 1e-300)
    t_chance = float(student.sf(t, n - 1)) if n > 2 else 1.0
    ranks = float(wilcoxon(left_out, alternative="greater").pvalue)
    least, rest = (
        (float(np.min(held_gains)), float(np.sum(held_gains) - np.max(held_gains)))
        if n > 1
        else (-np.inf, -np.inf)
    )
    return Agreement(t, t_chance, ranks, least, rest)


@dataclass(frozen=True)
class Refit:
    """A candidate refitted jointly with the base model and the effects chosen before it."""

    name: str
    fit: Fit
    gain: float
    """Reduction of the whitened residual's sum of squares, divided by the refit's mean square."""
    sizes: dict[str, float]
    """rms change of each channel that the candidate causes, as a fraction of the channel's rms."""
    agreement: Agreement
    worth_naming: bool
    """Whether gain and sizes exceed the naming threshold."""


class Alternative(NamedTuple):
    """The final fit with an alternative effect substituted for the chosen effect."""

    fit: Fit
    loss: float
    """Increase of the whitened sum of squares, divided by the final fit's mean square."""
    sizes: dict[str, float]
    """rms difference between the readings of the two fits, as a fraction of each channel's rms."""
    discrepancies: dict[str, float]
    """Model-discretisation discrepancy of each channel in the noise of both fits."""
    fewer: int = 0
    """Number of fitted parameters of the final fit, minus the number of this fit."""
    agreement: "Agreement | None" = None
    """Cross-validation of the alternative with all other effects in the model. None: the final
    model contains the alternative already."""

    def is_excluded(self, settings: SelectionSettings = DEFAULT_SETTINGS) -> bool:
        """Returns whether the chosen effect fits better by at least the naming threshold.

        The threshold allows for the parameters that only the chosen effect has.
        """
        more = 1 + max(self.fewer, 0)
        return settings.worth_naming(self.loss, self.sizes, self.discrepancies, more)

    def is_better(self, settings: SelectionSettings = DEFAULT_SETTINGS) -> bool:
        """Returns whether the alternative fits better by at least the naming threshold.

        Cross-validation must confirm the alternative too.
        """
        more = 1 + max(-self.fewer, 0)
        better = settings.worth_naming(-self.loss, self.sizes, self.discrepancies, more)
        return better and self.agreement is not None and self.agreement.agreed(settings)


class Growth(NamedTuple):
    """Growth of the error in the held-out trials by an effect."""

    mean: float
    """Mean of log(S1/S0) over the held-out trials, with the whitened sums of squares S0 without
    the effect and S1 with the effect."""
    error: float
    """Standard error of `mean` that noise alone causes."""

    def vetoes(self, settings: SelectionSettings = DEFAULT_SETTINGS) -> bool:
        """Returns whether the held-out trials contradict the effect."""
        return self.mean > max(settings.veto_growth, settings.veto_errors * self.error)


@dataclass
class SelectionStep:
    """One round of the selection: scores, refits, and the chosen effect with its alternatives."""

    scores: list[Score]
    refitted: list[Refit] = field(default_factory=list)
    chosen: str | None = None
    equivalent: list[str] = field(default_factory=list)
    """Effects that these data cannot discriminate from the chosen effect."""
    alternatives: dict[str, Alternative] = field(default_factory=dict)
    """All effects that were substituted for the chosen effect after the selection."""
    taken_out: str | None = None
    """Effect that this round chose and a later round removed because it was unnecessary."""
    replaced: str | None = None
    """Effect that this round chose first and that an alternative replaced."""
    exchanged: list[str] = field(default_factory=list)
    """Alternatives that were found after the selection, beside all other chosen effects."""


@dataclass
class Selection:
    """A selection: the fit of the base model, the rounds and the final fit."""

    base: Fit
    final: Fit
    effects: list[str]
    rounds: list[SelectionStep]
    settings: SelectionSettings = DEFAULT_SETTINGS
    entries: Sequence[Parameter] = ()
    """Entries of the parameter vector, with the prior ranges of the final fit."""
    declared: dict[int, Prior] = field(default_factory=dict)
    """Declared prior of each entry whose range became wider, because a fit ended at an edge."""
    vetoed: dict[str, Growth] = field(default_factory=dict)
    """Effects that were selected and then removed, because they increase the held-out error."""
    measured: dict[str, Discrepancy] = field(default_factory=dict)
    """Discrepancies that were measured from the residual of the last fit. Empty if the model has
    only one mesh."""
    discrepancies: dict[str, float] = field(default_factory=dict)
    """Model-discretisation discrepancy of each channel in the noise of the final fit."""


def can_join(name: str, effects: Sequence[str]) -> bool:
    """Returns whether a model with `effects` can also contain the effect `name`."""
    taken = {LIBRARY[n].replaces_law for n in effects} - {""}
    return name not in effects and LIBRARY[name].replaces_law not in taken


def effect_entries(entries: Sequence[Parameter]) -> dict[str, np.ndarray]:
    """Returns the indices in `entries` of every effect's parameters."""
    names = dict.fromkeys(p.effect for p in entries if p.effect)
    return {n: np.array([i for i, p in enumerate(entries) if p.effect == n]) for n in names}


def scoring_entries(entries: Sequence[Parameter]) -> dict[str, np.ndarray]:
    """Returns, for every effect, the indices of the parameters from which it is scored.

    These are the parameters with a `Prior.start`, or, if none has a `Prior.start`, all parameters
    except shape parameters.
    """
    found = {}
    for name, group in effect_entries(entries).items():
        started = [i for i in group if entries[i].prior.start is not None]
        strengths = [i for i in group if not entries[i].is_shape]
        found[name] = np.array(started or strengths)
    return found


def relative_changes(
    problem: AbstractProblem, before: Sequence[np.ndarray], after: Sequence[np.ndarray]
) -> dict[str, float]:
    """Returns every channel's rms change over all trials, as a fraction of the channel's rms.

    Only measured readings count: the change of a reading that no sensor measured is no evidence.
    """
    found = {}
    for channel in dict.fromkeys(name for _, name in problem.noise):
        row, changes, signals = problem.all_channels.row(channel), [], []
        for record, a, b in zip(problem.records, before, after, strict=True):
            there = record.there(channel)
            changes.append((b[row] - a[row])[there])
            signals.append(a[row][there])
        change, signal = np.concatenate(changes), np.concatenate(signals)
        found[channel] = float(np.sqrt(np.mean(change**2) / max(np.mean(signal**2), 1e-300)))
    return found
