"""The trial that makes a class smaller: that tells what a search found from its rivals.

At the end of a search the model was fitted with the effect that was found, and again with each
rival in its place. What the former would read less what the latter would, d, is what a rival is to
be caught by. With J the tangents of the rival's model, which may move as it is fitted again,

    lambda = min over x of |W (d + J x)|^2

over the trials that there are and one more is by how much worse the rival will fit, the noncentral
chi-square of taking it for the right one. `rivals` tells them apart by that, and by how much the
channels still differ.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from calibration.fit import inverse
from calibration.foresight import Foresight, Seen, information, left, shares
from calibration.next_trial import Effort, Limits, Search, as_table, toml, words
from calibration.noise import DISCREPANCY
from calibration.rounds import LEAST_GAIN
from slider_jax.schema import Trial

MOST = 12
"""Times that a trial is foreseen to be run."""


class Apart(NamedTuple):
    """How far apart the readings put what was found and a rival."""

    sigmas: float
    shares: dict[str, float]
    """By what share of its rms every channel differs."""

    @property
    def certainty(self) -> float:
        """1 where they are just told apart."""
        return min(self.sigmas**2 / LEAST_GAIN, self.beyond[1] ** 2)

    @property
    def beyond(self) -> tuple[str, float]:
        """The channel that differs by most of what correct programs do, and by how much of it."""
        found = {c: x / DISCREPANCY[c] for c, x in self.shares.items()}
        return max(found.items(), key=lambda item: item[1])


def apart(seen: Sequence[Seen]) -> Apart:
    """By what was seen of a rival's model and, the last, of the other."""
    A = information(seen)
    rest, last = np.arange(len(A) - 1), np.array([len(A) - 1])
    step = np.ones(len(A))
    step[rest] = -(inverse(A[np.ix_(rest, rest)]) @ A[np.ix_(rest, last)])[:, 0]
    return Apart(float(np.sqrt(max(left(A, last, rest)[0, 0], 0.0))), shares(seen, step))


def split(
    name: str,
    foresights: Mapping[str, Foresight],
    trials: Sequence[Trial],
    limits: Limits,
    effort: Effort = Effort(),
    progress: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """The trial that tells the effect `name` from most of its rivals, as reports write it.

    `foresights` are of the rivals' models, the other one that with the effect; `trials` those there
    are. "times" is how often the trial must be run until one of the rivals is told apart, None
    where `MOST` times are not enough.
    """
    before = [f.trials(trials, progress) for f in foresights.values()]

    def after(seen: list[list[Seen]], times: int = 1) -> list[Apart]:
        return [apart([*was, *(times * x)]) for was, x in zip(before, seen, strict=True)]

    def goal(seen: list[list[Seen]]) -> float:
        found = np.array([x.certainty for x in after(seen)])
        return float(np.minimum(found, 1.0).mean() + 1e-3 * found.mean())

    best = Search(list(foresights.values()), goal, limits).run(effort, progress)
    now, then = [apart(was) for was in before], after(best.seen)
    times = next(
        (n for n in range(1, MOST + 1) if any(x.certainty > 1.0 for x in after(best.seen, n))), None
    )
    place = max(range(len(then)), key=lambda i: then[i].certainty)
    rival = list(foresights)[place]
    said = (
        f"{words(best.trial)} tells {name} from {rival} best: "
        f"by {_difference(now[place], then[place])}."
    )
    if times is None:
        said += " That is too little to tell them apart: no trial within the limits does."
    elif times > 1:
        said += f" {times} such trials would tell them apart."
    rows = [
        {"first": name, "second": other}
        | {"sigmas_before": a.sigmas, "sigmas_after": b.sigmas}
        | {"differ_before": a.shares, "differ_after": b.shares}
        for other, a, b in zip(foresights, now, then, strict=True)
    ]
    return {
        "purpose": "separate",
        "said": said[0].upper() + said[1:],
        "trial": as_table(best.trial),
        "toml": toml(best.trial),
        "times": times,
        "pairs": rows,
        "limits": limits._asdict(),
    }


def _difference(now: Apart, then: Apart) -> str:
    channel, _ = then.beyond
    was, differ, programs = (100.0 * x[channel] for x in (now.shares, then.shares, DISCREPANCY))
    return (
        f"{then.sigmas:.1f} standard deviations ({now.sigmas:.1f} without it) and {differ:.2g} % "
        f"of {channel} ({was:.2g} %), where correct programs differ by {programs:.2g} %"
    )
