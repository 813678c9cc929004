"""Tabulates a learned function, with its band, over the states that the trials visited."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from calibration.discrepancy.rounds import scoring_entries
from calibration.inference.uncertainty import EFFECT_DISCREPANCY
from calibration.learning.learn import Learning
from calibration.learning.states import RARE, visited_states
from slider_jax.effects import Curve
from slider_jax.effects.dictionary.details import FINE_PARTS
from slider_jax.effects.library import KNOWN_EFFECTS

POINTS = 41
"""Number of states in a table."""


class LearnedCurve(NamedTuple):
    """A table of one term's function, including its fine part."""

    term: str
    part: str
    """Part of the robot, "body" or "tail", or "" for a term without parts."""
    texts: Curve
    state: np.ndarray
    value: np.ndarray
    low: np.ndarray
    """Lower end of the 95 % band."""
    high: np.ndarray


def learned_curves(learning: Learning) -> list[LearnedCurve]:
    """Returns a table of every learned term and part, over the states of the fitted trials.

    The 95 % band includes the covariance of the coefficients and the discretisation error.
    """
    learned = learning.model
    assert learned is not None
    fit, problem = learned.fit, learned.problem
    entries, theta = learned.dictionary.entries, jnp.asarray(fit.theta)
    models = [jax.tree.map(jnp.asarray, p.extended.at(theta)) for p in problem.coarse_plans]
    covariance = fit.widened_covariance
    values = {
        n: {p.name: theta[i] for i, p in enumerate(entries) if p.effect == n}
        for n in (*learned.terms, *learned.fine_parts)
    }
    terms: dict[str, Any] = {n: KNOWN_EFFECTS[n](**values[n]) for n in learned.terms}
    each = [
        visited_states(p, model, y, terms)
        for p, model, y in zip(problem.coarse_plans, models, fit.predicted, strict=True)
    ]
    found = []
    for name, effect in terms.items():
        kind, groups, visited = type(effect), scoring_entries(entries), [x[name] for x in each]
        parts, group = [effect], groups[name]
        fine = FINE_PARTS[name] if name in FINE_PARTS else None
        if fine is not None and fine.name() in learned.fine_parts:
            parts.append(fine(**values[fine.name()]))
            group = np.concatenate([group, groups[fine.name()]])
        place = np.array([int(np.flatnonzero(fit.free == i)[0]) for i in group])
        for part in visited[0]:
            z = np.concatenate([x[part] for x in visited])
            low, high = np.quantile(z[np.isfinite(z)], [RARE, 1.0 - RARE])
            state = np.linspace(low, high, POINTS)
            basis = np.concatenate([np.asarray(x.basis(jnp.asarray(state))) for x in parts])
            chosen = np.array([list(kind.priors()).index(part)]) if part else slice(None)
            basis, rows = basis.reshape(-1, POINTS), place[chosen]
            value = fit.theta[group[chosen]] @ basis
            spread = np.einsum("kn,kl,ln->n", basis, covariance[np.ix_(rows, rows)], basis)
            band = 1.96 * np.hypot(np.sqrt(np.maximum(spread, 0.0)), EFFECT_DISCREPANCY * value)
            texts = kind.term_curve
            assert texts is not None
            found.append(LearnedCurve(name, part, texts, state, value, value - band, value + band))
    return found


def curve_record(x: LearnedCurve) -> dict[str, Any]:
    """Returns a table of report.json."""
    rows: Sequence[tuple[str, np.ndarray]] = [
        ("state", x.state), ("value", x.value), ("low", x.low), ("high", x.high)
    ]  # fmt: skip
    names = {
        "term": x.term, "part": x.part, "state_name": x.texts.state, "state_unit": x.texts.unit,
        "value_name": x.texts.value, "value_unit": x.texts.value_unit,
    }  # fmt: skip
    return names | {key: values.tolist() for key, values in rows}
