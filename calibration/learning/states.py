"""Computes the states that a trial visits, for each term of the dictionary."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from calibration.inference.gauss_newton import Fit
from calibration.inference.problem import TankProblem
from calibration.model.plan import BLOCK, TrialPlan, padded_times
from slider_jax.actuation import rear_of
from slider_jax.beam.equations import Section
from slider_jax.dynamics.model import Model
from slider_jax.dynamics.pressures import chamber_history, set_pressures, start_chambers
from slider_jax.dynamics.step import Snapshot, at_rest
from slider_jax.effects import Chamber, Readings
from slider_jax.effects.dictionary.flow import FlowOfLaggedDifference
from slider_jax.effects.functions import RigDrift, Sine
from slider_jax.effects.library import DICTIONARY
from slider_jax.programs import compiled_once
from slider_jax.simulation.trial import advance_chunk, run_chunks

RARE = 0.005
"""Fraction of the visited states beyond each end of a function's table. The same fraction of the
states exceeds the scale of a term. A state has extreme values when the drive switches."""
OF_READINGS = ("Instrument", "WaterMotion")
"""Places whose terms depend on the readings or their times."""
OF_TIME = (RigDrift, Sine, FlowOfLaggedDifference)
"""Terms of other places that depend on the times of the readings."""
OF_CHAMBERS = ("Command", "Flow", "ActingPressure")
"""Places whose other terms depend on the state of the chambers."""
READINGS, CHAMBERS, SECTIONS = "readings", "chambers", "sections"
"""Arguments of a term's state: the readings, the chambers, or the cells of the robot."""
PARTS = ("body", "tail")
"""Parts of the robot that have their own parameter in some terms."""


def _section(x: Snapshot) -> Section:
    return x.section()


def visited_states(
    plan: TrialPlan, model: Model, readings: np.ndarray, terms: Mapping[str, Any]
) -> dict[str, dict[str, np.ndarray]]:
    """Returns the states of each term (effects by name) that a trial visits, by part of the robot.

    The part is "body" or "tail", or "" for a term that has no parameter for each part. `readings`
    (channels, samples) are the predicted readings of the trial.
    """
    groups: dict[str, dict[str, Any]] = {READINGS: {}, CHAMBERS: {}, SECTIONS: {}}
    for name, term in terms.items():
        groups[_source(term)][name] = term
    found: dict[str, dict[str, np.ndarray]] = {}
    if groups[READINGS]:
        channels = plan.extended.channels
        true = dict(zip(channels, jnp.asarray(readings), strict=True))
        read = channels.readings(jnp.asarray(plan.at), true)
        for name, z in _states(groups[READINGS], read).items():
            found[name] = {"": np.ravel(z)}
    if groups[CHAMBERS]:
        t = jnp.asarray(padded_times(np.asarray(plan.grid.times)))
        p, p_set = _visited_chambers(model, t)
        rear, none = rear_of(p.shape[-1]), jnp.zeros((0, *p.shape))
        chamber = Chamber(p, p_set, jnp.ones(()), rear, jnp.sign(p), none)
        for name, z in _states(groups[CHAMBERS], chamber).items():
            found[name] = {"": np.ravel(z[: plan.grid.steps])}
    if groups[SECTIONS]:
        section, blocks = _states_along(plan, model, groups[SECTIONS])
        for name, term in groups[SECTIONS].items():
            z = np.concatenate([x.pop(name) for x in blocks])[: plan.grid.steps]
            found[name] = _in_parts(term, z, section)
    return found


def _source(term: Any) -> str:
    """Returns what the state of a term depends on."""
    if term.place() in OF_READINGS or isinstance(term, OF_TIME):
        return READINGS
    return CHAMBERS if term.place() in OF_CHAMBERS else SECTIONS


@compiled_once
def _states(terms: Mapping[str, Any], x: Readings | Chamber | Section) -> dict[str, jax.Array]:
    """Returns the state of each term (effects by name) at all times of `x`."""
    return {name: term.state(x) for name, term in terms.items()}


@compiled_once
def _visited_chambers(model: Model, t: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Returns pressures and set pressures [Pa], each (n - 1, chambers), at the times t[1:] [s]."""
    return chamber_history(model, start_chambers(model), t).p, set_pressures(model, t).b1


def _states_along(
    plan: TrialPlan, model: Model, terms: Mapping[str, Any]
) -> tuple[Section, list[dict[str, jax.Array]]]:
    """Returns the first section, and the states (steps, cells) of `terms` in each block of steps.

    The sections of the other blocks are not kept.
    """
    h = jnp.asarray(plan.grid.h)
    first: list[Section] = []

    def advance(done: int, carry):
        t0 = jnp.asarray(plan.grid.h * done)
        sections, carry = advance_chunk(
            model, h, t0, carry, _section, plan.numerics, plan.scheme, BLOCK
        )
        if not first:
            first.append(jax.tree.map(lambda x: x[0], sections))
        return _states(terms, sections), carry

    blocks = run_chunks(advance, at_rest(model, plan.numerics), plan.grid.steps, BLOCK)[0]
    return first[0], blocks


def _in_parts(term: Any, z: np.ndarray, section: Section) -> dict[str, np.ndarray]:
    """Returns the states `z` (steps, cells) of a term by part of the robot.

    `section` says which cells are in the tail, and in which cells the term acts.
    """
    if set(term.priors()) == set(PARTS):
        tail = np.asarray(section.in_tail) > 0.5
        return {"body": z[:, ~tail].ravel(), "tail": z[:, tail].ravel()}
    return {"": z[:, np.asarray(term.cells(section)) > 0.5].ravel()}


def largest_states(problem: TankProblem, fit: Fit) -> dict[str, float]:
    """Returns the scale of each term that has one: the quantile 1 - `RARE` of |state|.

    `fit` is a fit to the trials of `problem`.
    """
    terms = {n: kind() for n, kind in DICTIONARY.items() if "scale" in kind.shapes()}
    theta = jnp.asarray(fit.theta)
    visited = [
        visited_states(p, jax.tree.map(jnp.asarray, p.extended.at(theta)), y, terms)
        for p, y in zip(problem.coarse_plans, fit.predicted, strict=True)
    ]
    found = {}
    for name in terms:
        z = np.abs(np.concatenate([x[name][""] for x in visited]))
        z = z[np.isfinite(z)]
        if z.size:  # a robot without tail has no states of the tail
            found[name] = float(np.quantile(z, 1.0 - RARE))
    return found
