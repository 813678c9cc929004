"""The trial that makes a class smaller: that tells what a search found from a rival.

At the end of a search the model was fitted with the effect that was found, and again with each
rival in its place. Which of the two is right is not known. Where it is the former, let d be what it
would read less what the latter would, and J the tangents of the latter, which moves as it is fitted
again:

    lambda = min over x of |W (d + J x)|^2

over the trials that there are and one more is by how much worse the latter will fit, the noncentral
chi-square of taking it for the right one. Where it is the latter, the former follows instead. The
larger counts: a rival with more freedom may follow whatever it is not, and still be what is right.
`rivals` tells them apart by that and by how much the channels still differ.
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
    as_table,
    trial_text,
    trial_toml,
)
from calibration.inference.gauss_newton import inverse, marginal_information
from slider_jax.channels import CHANNELS
from slider_jax.experiment.schema import Trial

TIMES = 12
"""How often a trial is predicted to be run, at most."""


class Distance(NamedTuple):
    """How far apart the readings put two models of which one may move."""

    sigmas: float
    shares: dict[str, float]
    """By what share of its rms every channel differs."""

    @property
    def of_enough(self) -> float:
        """1 where they are just told apart."""
        return min(self.sigmas**2 / DEFAULT_SETTINGS.min_gain, self.channel[1] ** 2)

    @property
    def channel(self) -> tuple[str, float]:
        """The channel that differs by most of what correct programs do, and by how much of it."""
        found = {c: x / CHANNELS[c].discrepancy for c, x in self.shares.items()}
        return max(found.items(), key=lambda item: item[1])


def distance(channels: Sequence[ChannelInformation], unit: float) -> Distance:
    """By what was channels along the moving model's parameters and, the last, towards the other.

    `unit` is the residual's mean square.
    """
    A = information(channels)
    rest, last = np.arange(len(A) - 1), np.array([len(A) - 1])
    step = np.ones(len(A))
    step[rest] = -(inverse(A[np.ix_(rest, rest)]) @ A[np.ix_(rest, last)])[:, 0]
    square = max(float(marginal_information(A, last, rest)[0, 0]), 0.0)
    return Distance(float(np.sqrt(square / unit)), channel_shares(channels, step))


def split_class(
    name: str,
    predictions: Mapping[str, tuple[TrialInformation, TrialInformation]],
    unit: float,
    trials: Sequence[Trial],
    limits: TrialLimits,
    effort: SearchEffort = SearchEffort(),
    progress: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """The trial that soonest tells the effect `name` from one of its rivals, as reports write it.

    `predictions` are those of each rival's model and of that with the effect, each towards the
    other; `trials` those that both were fitted to, with a residual whose mean square is `unit`.
    "times" is how often the trial must be run until a rival is told apart, None where `TIMES` are
    not enough.
    """
    ways = [f for pair in predictions.values() for f in pair]
    before = [f.trials(trials, progress) for f in ways]

    def after(channels: list[list[ChannelInformation]], times: int = 1) -> list[Distance]:
        """Of each rival."""
        found = [distance([*a, *(times * b)], unit) for a, b in zip(before, channels, strict=True)]
        pairs = zip(found[::2], found[1::2], strict=True)
        return [max(pair, key=lambda x: x.of_enough) for pair in pairs]

    def needed(channels: list[list[ChannelInformation]]) -> int | None:
        counts = range(1, TIMES + 1)
        return next((n for n in counts if any(x.of_enough > 1.0 for x in after(channels, n))), None)

    def goal(channels: list[list[ChannelInformation]]) -> float:
        """The fewest times, then how near all rivals come, then how far the trial puts them."""
        found = np.array([x.of_enough for x in after(channels)])
        far = np.mean(np.minimum(found, 1.0)) + 1e-2 * np.mean(found / (1.0 + found))
        return float(far) - 2.0 * (needed(channels) or TIMES + 1)

    best = TrialSearch(ways, goal, limits).run(effort, progress)
    times = needed(best.channels)
    now, then, at_last = (after(best.channels, n) for n in (0, 1, times or TIMES))
    alternatives = list(predictions)
    first = max(range(len(alternatives)), key=lambda i: at_last[i].of_enough)
    said = (
        f"{trial_text(best.trial)} tells {name} from {alternatives[first]} best: "
        f"by {_difference(now[first], then[first])}."
    )
    if times is None:
        said += (
            f" That is too little to tell them apart, as with every trial tried within the limits, "
            f"run up to {TIMES} times."
        )
    elif times > 1:
        said += f" {times} such trials would tell them apart."
    rows = [
        {"first": name, "second": other}
        | {"sigmas_before": a.sigmas, "sigmas_after": b.sigmas}
        | {"differ_before": a.shares, "differ_after": b.shares}
        for other, a, b in zip(alternatives, now, then, strict=True)
    ]
    return {
        "purpose": "separate",
        "said": said[0].upper() + said[1:],
        "trial": as_table(best.trial),
        "toml": trial_toml(best.trial),
        "times": times,
        "pairs": rows,
        "limits": limits._asdict(),
    }


def _difference(now: Distance, then: Distance) -> str:
    channel, _ = then.channel
    was, differ, programs = (
        100.0 * x
        for x in (now.shares[channel], then.shares[channel], CHANNELS[channel].discrepancy)
    )
    return (
        f"{then.sigmas:.1f} standard deviations ({now.sigmas:.1f} without it) and {differ:.2g} % "
        f"of {channel} ({was:.2g} %), where correct programs differ by {programs:.2g} %"
    )
