"""Ways in which parameters may depend on the drive frequency, as affine maps of one vector.

The same fit then serves them all: `constant` values, the `paper`'s ramp with its own numbers, the
same `ramp` with the numbers at its ends identified, and values of their own for every frequency.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from calibration.inference.problem import Affine
from calibration.model.extended import Parameter
from slider_jax.errors import InputError
from slider_jax.experiment.schema import Trial
from slider_jax.paper import RAMP_END, RAMP_START, force_coefficients

CONSTANT, PAPER, RAMP, EACH = "constant", "paper", "ramp", "per_frequency"
FOLLOWS = ("C_d", "m_a")
"""What the paper's ramp is of."""
SAME = 0.02
"""Share by which the frequencies of one group differ at most."""


class ParameterTies(NamedTuple):
    """A vector, and what it makes of every trial."""

    name: str
    entries: list[Parameter]
    labels: list[str]
    """Of the entries; those of one frequency say it."""
    maps: tuple[Affine, ...]
    start: np.ndarray
    group: np.ndarray
    """(entries,) place of the frequency that an entry belongs to, or -1."""
    member: np.ndarray
    """(entries,) place among the trial's parameters that an entry is of."""


def frequencies(trials: Sequence[Trial]) -> tuple[np.ndarray, np.ndarray]:
    """Drive frequencies [Hz] that occur, rising, and the place (trials,) of every trial's.

    Raises `InputError` for a trial without a drive frequency.
    """
    given = []
    for trial in trials:
        if trial.frequency is None:
            raise InputError(
                f"--per-frequency: trial {trial.file} has no frequency; calibrate without it, or "
                "take the trial out of the experiment file"
            )
        given.append(trial.frequency)
    order = np.argsort(given, kind="stable")
    place, firsts = np.zeros(len(given), int), list[float]()
    for i in order:
        if not firsts or given[i] > (1.0 + SAME) * firsts[-1]:
            firsts.append(given[i])
        place[i] = len(firsts) - 1
    means = [float(np.mean(np.array(given)[place == g])) for g in range(len(firsts))]
    return np.array(means), place


def constant(entries: Sequence[Parameter], theta: np.ndarray, trials: int) -> ParameterTies:
    """The same values in all trials."""
    same = Affine(np.zeros(len(theta)), np.eye(len(theta)))
    labels, nowhere = [p.label for p in entries], np.full(len(theta), -1)
    members = np.arange(len(theta))
    return ParameterTies(
        CONSTANT, list(entries), labels, (same,) * trials, theta.copy(), nowhere, members
    )


def paper(
    entries: Sequence[Parameter], theta: np.ndarray, at: np.ndarray, place: np.ndarray
) -> ParameterTies:
    """C_d and m_a of the paper's ramp, with the paper's numbers; the rest common."""
    common = [i for i, p in enumerate(entries) if p.label not in FOLLOWS]
    maps = []
    for g in place:
        offset = np.zeros(len(entries))
        for name, value in zip(FOLLOWS, force_coefficients(float(at[g])), strict=True):
            offset[_index(entries, name)] = float(value)
        maps.append(Affine(offset, np.eye(len(entries))[:, common]))
    kept = [entries[i] for i in common]
    labels, members = [p.label for p in kept], np.array(common)
    nowhere = np.full(len(common), -1)
    return ParameterTies(PAPER, kept, labels, tuple(maps), theta[common], nowhere, members)


def ramp(
    entries: Sequence[Parameter], theta: np.ndarray, at: np.ndarray, place: np.ndarray
) -> ParameterTies:
    """C_d and m_a constant below and above the paper's ramp, linear on it; the rest common."""
    common = [i for i, p in enumerate(entries) if p.label not in FOLLOWS]
    moving = [_index(entries, name) for name in FOLLOWS]
    members = np.array([*common, *(i for i in moving for _ in (0, 1))])
    along = np.clip((at - RAMP_START) / (RAMP_END - RAMP_START), 0.0, 1.0)
    maps = []
    for g in place:
        matrix = np.zeros((len(entries), len(members)))
        matrix[members, np.arange(len(members))] = 1.0
        for k, i in enumerate(moving):
            first = len(common) + 2 * k
            matrix[i, first : first + 2] = 1.0 - along[g], along[g]
        maps.append(Affine(np.zeros(len(entries)), matrix))
    labels = [entries[i].label for i in common]
    labels += [
        f"{n} {w}" for n in FOLLOWS for w in (f"below {RAMP_START:g} Hz", f"above {RAMP_END:g} Hz")
    ]
    return ParameterTies(
        RAMP, [entries[i] for i in members], labels, tuple(maps), theta[members],
        np.full(len(members), -1), members,
    )  # fmt: skip


def per_frequency(
    entries: Sequence[Parameter],
    theta: np.ndarray,
    at: np.ndarray,
    place: np.ndarray,
    each: Sequence[str],
) -> ParameterTies:
    """The parameters `each` (labels) by frequency; the rest common."""
    common = [i for i, p in enumerate(entries) if p.label not in each]
    own = [_index(entries, name) for name in each]
    members = np.array([*common, *(i for i in own for _ in at)])
    group = np.array([*(-1 for _ in common), *(g for _ in own for g in range(len(at)))])
    maps = []
    for g in place:
        matrix = np.zeros((len(entries), len(members)))
        here = np.flatnonzero((group == -1) | (group == g))
        matrix[members[here], here] = 1.0
        maps.append(Affine(np.zeros(len(entries)), matrix))
    labels = [
        entries[i].label + ("" if g < 0 else f" at {at[g]:g} Hz")
        for i, g in zip(members, group, strict=True)
    ]
    return ParameterTies(
        EACH, [entries[i] for i in members], labels, tuple(maps), theta[members], group, members
    )


def _index(entries: Sequence[Parameter], label: str) -> int:
    return next(i for i, p in enumerate(entries) if p.label == label)


def sees_the_ramp(at: np.ndarray) -> bool:
    """Whether there are frequencies on both halves of the ramp."""
    middle = 0.5 * (RAMP_START + RAMP_END)
    return bool((at < middle).any() and (at > middle).any())
