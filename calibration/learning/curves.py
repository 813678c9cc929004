"""Tabulates a learned function, with its band, over the states that the trials visited."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from calibration.discrepancy.rounds import scoring_entries
from calibration.inference.uncertainty import EFFECT_DISCREPANCY, correlations
from calibration.learning.learn import Learning
from calibration.model.predict import BLOCK, TrialPlan
from slider_jax.channels import BUILT_IN, row_of
from slider_jax.dynamics.model import Model
from slider_jax.dynamics.pressures import REAR, chamber_history, set_pressures, start_chambers
from slider_jax.dynamics.step import Snapshot, at_rest
from slider_jax.effects import Chamber, Curve, Flow, Instrument, Readings
from slider_jax.effects.library import DICTIONARY
from slider_jax.simulation.trial import advance_chunk, run_chunks

POINTS = 41
"""Number of states in a table."""
TAILS = 0.005
"""The table omits this fraction of the visited states at each end, because a state has extreme
values in the instants when the drive switches."""
PARTS = ("body", "tail")


class LearnedCurve(NamedTuple):
    """A table of one term's function."""

    term: str
    part: str
    """Part of the robot, "body" or "tail", or "" for a term without parts."""
    texts: Curve
    state: np.ndarray
    value: np.ndarray
    low: np.ndarray
    """Lower end of the 95 % band."""
    high: np.ndarray


def _section(x: Snapshot):
    return x.section()


def visited_states(
    plan: TrialPlan, model: Model, readings: np.ndarray, effect: Any
) -> dict[str, np.ndarray]:
    """Returns the states of a term that a simulated trial visits, by part.

    `readings` (channels, samples) are the predicted readings of the trial.
    """
    kind = type(effect)
    if issubclass(kind, Instrument):
        rows = [jnp.asarray(readings[row_of(name)]) for name in BUILT_IN]
        return {"": np.ravel(effect.state(Readings(jnp.asarray(plan.at), *rows)))}
    if issubclass(kind, Flow):
        t = jnp.asarray(plan.grid.times)
        p, p_set = chamber_history(model, start_chambers(model), t).p, set_pressures(model, t).b1
        x = Chamber(p, p_set, jnp.ones(()), REAR, jnp.sign(p))
        return {"": np.ravel(effect.state(x))}
    h = jnp.asarray(plan.grid.h)

    def advance(done: int, carry):
        t0 = jnp.asarray(plan.grid.h * done)
        return advance_chunk(model, h, t0, carry, _section, plan.numerics, plan.scheme, BLOCK)

    parts, _ = run_chunks(advance, at_rest(model, plan.numerics), plan.grid.steps, BLOCK)
    z = np.concatenate([effect.state(x) for x in parts])[: plan.grid.steps]
    tail = np.asarray(parts[0].in_tail[0]) > 0.5
    if set(kind.priors()) != set(PARTS):
        return {"": z.ravel()}
    return {"body": z[:, ~tail].ravel(), "tail": z[:, tail].ravel()}


def learned_curves(learning: Learning) -> list[LearnedCurve]:
    """Returns a table of every learned term and part, over the states of the estimation trials.

    The 95 % band includes the covariance of the coefficients and the discretisation error.
    """
    learned = learning.model
    assert learned is not None
    fit, problem = learned.fit, learned.problem
    entries, theta = learning.dictionary.entries, jnp.asarray(fit.theta)
    models = [jax.tree.map(jnp.asarray, p.extended.at(theta)) for p in problem.coarse_plans]
    covariance = correlations(fit) * np.outer(fit.errors, fit.errors)
    found = []
    for name in learned.terms:
        kind = DICTIONARY[name]
        own = {p.name: theta[i] for i, p in enumerate(entries) if p.effect == name}
        effect: Any = kind(**own)
        group = scoring_entries(entries)[name]
        place = np.array([int(np.flatnonzero(fit.free == i)[0]) for i in group])
        visited = [
            visited_states(p, model, y, effect)
            for p, model, y in zip(problem.coarse_plans, models, fit.predicted, strict=True)
        ]
        for part in visited[0]:
            z = np.concatenate([x[part] for x in visited])
            low, high = np.quantile(z[np.isfinite(z)], [TAILS, 1.0 - TAILS])
            state = np.linspace(low, high, POINTS)
            basis = np.asarray(effect.basis(jnp.asarray(state)))
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
