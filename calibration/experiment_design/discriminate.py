"""Searches for the trial that discriminates between a chosen effect and its alternatives.

After the selection, the model was fitted with the chosen effect and with each alternative. Suppose
that the first of two such models is true. Let d be the difference between the two models' readings,
J the tangents of the second model, x a change of its parameters, and W the whitening matrix:

    lambda = min over x of |W (d + J x)|^2

The sum of squares includes the existing trials and one new trial. Lambda is the expected loss of
the second model: the noncentrality of the chi-square test that rejects this model. Lambda is also
computed with the second model as the true one. The larger value is used, because a model with more
parameters may be able to imitate the true model. The module `alternatives` excludes a model by this
loss and by the difference between the readings of each channel.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from calibration.discrepancy.settings import DEFAULT_SETTINGS
from calibration.experiment_design.information import (
    ChannelInformation,
    TrialInformation,
    channel_shares,
    information,
)
from calibration.experiment_design.trial_search import (
    SearchEffort,
    TrialLimits,
    TrialSearch,
    next_trial_record,
    trial_text,
)
from calibration.inference.gauss_newton import inverse, marginal_information
from slider_jax.experiment.schema import Trial

MAX_REPEATS = 12
"""Largest number of repetitions of the new trial for which the distance is predicted."""
HOPELESS = 1e-4
"""The search ends early if, after each of the first new trials, the distance is below this fraction
of the naming threshold. Such models are equal in all trials, except for rounding errors."""


class ModelDistance(NamedTuple):
    """Distance between the readings of two models, after a refit of one model to the other."""

    sigmas: float
    """Square root of lambda: the distance in standard deviations of the noise."""
    shares: dict[str, float]
    """rms difference of the readings in each channel, as a fraction of the channel's rms."""
    discrepancies: dict[str, float]
    """Model-discretisation discrepancy of each channel, as a fraction of the channel's rms."""

    @property
    def threshold_ratio(self) -> float:
        """Returns the distance over the naming threshold; above 1, the data exclude a model."""
        return min(self.sigmas**2 / DEFAULT_SETTINGS.min_gain, self.channel[1] ** 2)

    @property
    def channel(self) -> tuple[str, float]:
        """Returns the channel with the largest ratio difference/discrepancy, and the ratio."""
        found = {c: x / max(self.discrepancies[c], 1e-300) for c, x in self.shares.items()}
        return max(found.items(), key=lambda item: item[1])


def model_distance(
    channels: Sequence[ChannelInformation], unit: float, discrepancies: dict[str, float]
) -> ModelDistance:
    """Returns the distance between a refitted model and a second model.

    The directions of the information in `channels` are the refitted model's parameters and, last,
    the difference between the models' readings. `unit` is the whitened residual's mean square.
    """
    A = information(channels)
    rest, last = np.arange(len(A) - 1), np.array([len(A) - 1])
    step = np.ones(len(A))
    step[rest] = -(inverse(A[np.ix_(rest, rest)]) @ A[np.ix_(rest, last)])[:, 0]
    square = max(float(marginal_information(A, last, rest)[0, 0]), 0.0)
    sigmas = float(np.sqrt(square / unit))
    return ModelDistance(sigmas, channel_shares(channels, step), discrepancies)


def discriminating_trial(
    name: str,
    predictions: Mapping[str, tuple[TrialInformation, TrialInformation]],
    unit: float,
    trials: Sequence[Trial],
    limits: TrialLimits,
    effort: SearchEffort = SearchEffort(),
    progress: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Returns the record of the trial that discriminates best between an effect and an alternative.

    For each alternative to the effect `name`, `predictions` contains two models: one with the
    alternative and one with the effect. Each model's field `other` contains the parameters of the
    other model. All models were fitted to `trials`. `unit` is the mean square of the residual.
    "times" in the record is how many repetitions exclude an effect (None: over `MAX_REPEATS`).
    """
    models = [f for pair in predictions.values() for f in pair]
    before = [f.trials(trials, progress) for f in models]
    discrepancies = models[0].sensing.discrepancies

    def after(channels: list[list[ChannelInformation]], times: int = 1) -> list[ModelDistance]:
        """Returns the distance of each alternative after `times` repetitions of the trial."""
        pairs = zip(before, channels, strict=True)
        found = [model_distance([*a, *(times * b)], unit, discrepancies) for a, b in pairs]
        both = zip(found[::2], found[1::2], strict=True)
        return [max(x, key=lambda d: d.threshold_ratio) for x in both]

    def needed(channels: list[list[ChannelInformation]]) -> int | None:
        for count in range(1, MAX_REPEATS + 1):
            if any(x.threshold_ratio > 1.0 for x in after(channels, count)):
                return count
        return None

    def goal(channels: list[list[ChannelInformation]]) -> float:
        """Returns the objective: fewer repetitions are better, then a larger mean distance."""
        found = np.array([x.threshold_ratio for x in after(channels)])
        far = np.mean(np.minimum(found, 1.0)) + 1e-2 * np.mean(found / (1.0 + found))
        return float(far) - 2.0 * (needed(channels) or MAX_REPEATS + 1)

    hopeless = HOPELESS - 2.0 * (MAX_REPEATS + 1)
    best = TrialSearch(models, goal, limits, hopeless).run(effort, progress)
    times = needed(best.channels)
    now, then, at_last = (after(best.channels, n) for n in (0, 1, times or MAX_REPEATS))
    alternatives = list(predictions)
    first = max(range(len(alternatives)), key=lambda i: at_last[i].threshold_ratio)
    text = (
        f"{trial_text(best.trial)} discriminates best between {name} and {alternatives[first]}: "
        f"{_difference(now[first], then[first])}."
    )
    if times is None:
        text += (
            " No trial within the limits excludes one of the effects, even if the trial is run "
            f"{MAX_REPEATS} times."
        )
    elif times > 1:
        text += f" {times} such trials would exclude one of the effects."
    rest = [n for n, x in zip(alternatives, at_last, strict=True) if x.threshold_ratio <= 1.0]
    if times is not None and rest:
        subject = "This trial does" if times == 1 else "These trials do"
        text += f" {subject} not discriminate between {name} and {', '.join(rest)}."
    rows = [
        {"first": name, "second": other}
        | {"sigmas_before": a.sigmas, "sigmas_after": b.sigmas}
        | {"differ_before": a.shares, "differ_after": b.shares}
        for other, a, b in zip(alternatives, now, then, strict=True)
    ]
    return next_trial_record("separate", text, best.trial, limits) | {"times": times, "pairs": rows}


def _difference(now: ModelDistance, then: ModelDistance) -> str:
    channel, _ = then.channel
    return (
        f"their distance grows from {now.sigmas:.1f} to {then.sigmas:.1f} standard deviations, and "
        f"the difference in {channel} from {100.0 * now.shares[channel]:.2g} to "
        f"{100.0 * then.shares[channel]:.2g} % (model-discretisation discrepancy "
        f"{100.0 * then.discrepancies[channel]:.2g} %)"
    )
