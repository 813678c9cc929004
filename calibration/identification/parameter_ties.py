"""Ties of parameters: rules for how the parameters depend on the drive frequency of a trial.

There are four kinds of ties: constant values, the paper's ramp of C_d and m_a with the published
values, the same ramp with identified end values, and separate values for every frequency. The ramp
changes linearly between 2 and 3 Hz, and is constant outside. A fit determines one vector for all
trials. An affine map computes the parameters of each trial from this vector.
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
RAMP_PARAMETERS = ("C_d", "m_a")
"""Parameters that follow the paper's ramp."""
SAME_FREQUENCY = 0.02
"""Two drive frequencies count as one if their relative difference is at most this value."""


class ParameterTies(NamedTuple):
    """One kind of ties: the fitted vector, and maps from this vector to each trial's parameters."""

    name: str
    entries: list[Parameter]
    labels: list[str]
    """Labels (entries,). If an entry is for one frequency, its label contains the frequency."""
    maps: tuple[Affine, ...]
    """Maps from the fitted vector to the parameters of a trial, one map for each trial."""
    start: np.ndarray
    """Values (entries,) at which a fit starts, in SI units."""
    group: np.ndarray
    """Index (entries,) of the frequency at which an entry is used, or -1 for all frequencies."""
    parameter: np.ndarray
    """Index (entries,) of each entry's parameter in the list of a trial's parameters."""


def drive_frequencies(trials: Sequence[Trial]) -> tuple[np.ndarray, np.ndarray]:
    """Returns the distinct drive frequencies [Hz], ascending, and each trial's frequency index.

    Raises `InputError` for a trial without a drive frequency.
    """
    given = []
    for trial in trials:
        if trial.frequency is None:
            raise InputError(
                f"--per-frequency: trial {trial.file} has no frequency; omit --per-frequency, or "
                "remove the trial from the experiment file"
            )
        given.append(trial.frequency)
    order = np.argsort(given, kind="stable")
    place, firsts = np.zeros(len(given), int), list[float]()
    for i in order:
        if not firsts or given[i] > (1.0 + SAME_FREQUENCY) * firsts[-1]:
            firsts.append(given[i])
        place[i] = len(firsts) - 1
    means = [float(np.mean(np.array(given)[place == g])) for g in range(len(firsts))]
    return np.array(means), place


def constant_ties(
    entries: Sequence[Parameter], theta: np.ndarray, at: np.ndarray, place: np.ndarray
) -> ParameterTies:
    """Returns the ties with constant values. `place` (trials,) are indices of `at` [Hz]."""
    return per_frequency_ties(entries, theta, at, place, ())._replace(name=CONSTANT)


def paper_ties(
    entries: Sequence[Parameter], theta: np.ndarray, at: np.ndarray, place: np.ndarray
) -> ParameterTies:
    """Returns the ties with C_d and m_a of the paper's ramp."""
    common = [i for i, p in enumerate(entries) if p.label not in RAMP_PARAMETERS]
    maps = []
    for g in place:
        offset = np.zeros(len(entries))
        for name, value in zip(RAMP_PARAMETERS, force_coefficients(float(at[g])), strict=True):
            offset[_index(entries, name)] = float(value)
        maps.append(Affine(offset, np.eye(len(entries))[:, common]))
    return _ties(PAPER, entries, theta, common, [entries[i].label for i in common], maps)


def ramp_ties(
    entries: Sequence[Parameter], theta: np.ndarray, at: np.ndarray, place: np.ndarray
) -> ParameterTies:
    """Returns the ties with fitted values of C_d and m_a at the two ends of the paper's ramp."""
    common = [i for i, p in enumerate(entries) if p.label not in RAMP_PARAMETERS]
    moving = [_index(entries, name) for name in RAMP_PARAMETERS]
    indices = [*common, *(i for i in moving for _ in (0, 1))]
    along = np.clip((at - RAMP_START) / (RAMP_END - RAMP_START), 0.0, 1.0)
    maps = []
    for g in place:
        matrix = np.eye(len(entries))[:, indices]
        for k, i in enumerate(moving):
            first = len(common) + 2 * k
            matrix[i, first : first + 2] = 1.0 - along[g], along[g]
        maps.append(Affine(np.zeros(len(entries)), matrix))
    ends = (f"below {RAMP_START:g} Hz", f"above {RAMP_END:g} Hz")
    labels = [entries[i].label for i in common]
    labels += [f"{name} {end}" for name in RAMP_PARAMETERS for end in ends]
    return _ties(RAMP, entries, theta, indices, labels, maps)


def per_frequency_ties(
    entries: Sequence[Parameter],
    theta: np.ndarray,
    at: np.ndarray,
    place: np.ndarray,
    each: Sequence[str],
) -> ParameterTies:
    """Returns the ties with one value per frequency for parameters whose label is in `each`."""
    common = [i for i, p in enumerate(entries) if p.label not in each]
    own = [_index(entries, name) for name in each]
    indices = [*common, *(i for i in own for _ in at)]
    group = np.array([*(-1 for _ in common), *(g for _ in own for g in range(len(at)))])
    maps = [
        Affine(
            np.zeros(len(entries)),
            np.eye(len(entries))[:, indices] * ((group == -1) | (group == g)),
        )
        for g in place
    ]
    labels = [
        entries[i].label + ("" if g < 0 else f" at {at[g]:g} Hz")
        for i, g in zip(indices, group, strict=True)
    ]
    return _ties(EACH, entries, theta, indices, labels, maps)._replace(group=group)


def _ties(name, entries, theta, indices, labels, maps) -> ParameterTies:
    own, ungrouped = [entries[i] for i in indices], np.full(len(indices), -1)
    start, parameter = theta[indices], np.array(indices)
    return ParameterTies(name, own, labels, tuple(maps), start, ungrouped, parameter)


def _index(entries: Sequence[Parameter], label: str) -> int:
    return next(i for i, p in enumerate(entries) if p.label == label)


def spans_ramp(at: np.ndarray) -> bool:
    """Returns whether some frequencies in `at` [Hz] are below the ramp's middle and some above."""
    middle = 0.5 * (RAMP_START + RAMP_END)
    return bool((at < middle).any() and (at > middle).any())
