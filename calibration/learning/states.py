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
from slider_jax.programs import kept_once
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
    of_readings = {
        n: x for n, x in terms.items() if x.place() in OF_READINGS or isinstance(x, OF_TIME)
    }
    rest = {n: x for n, x in terms.items() if n not in of_readings}
    of_chambers = {n: x for n, x in rest.items() if x.place() in OF_CHAMBERS}
    local = {n: x for n, x in rest.items() if n not in of_chambers}
    channels, steps = plan.extended.channels, plan.grid.steps
    whole: dict[str, jax.Array] = {}
    found = {}
    if of_readings:
        true = dict(zip(channels, jnp.asarray(readings), strict=True))
        whole |= _states(of_readings, channels.readings(jnp.asarray(plan.at), true))
    if of_chambers:
        t = jnp.asarray(padded_times(np.asarray(plan.grid.times)))
        visited = _states_of_chambers(of_chambers, model, t)
        whole |= {name: z[:steps] for name, z in visited.items()}
    if local:
        sections = _visited_sections(plan, model)
        parts = [_states(local, x) for x in sections]
        for name, term in local.items():
            z = np.concatenate([x[name] for x in parts])[:steps]
            found[name] = _in_parts(term, z, sections[0])
    return found | {name: {"": np.ravel(z)} for name, z in whole.items()}


@kept_once
def _states(terms: Mapping[str, Any], x: Readings | Section) -> dict[str, jax.Array]:
    return {name: term.state(x) for name, term in terms.items()}


@kept_once
def _states_of_chambers(
    terms: Mapping[str, Any], model: Model, t: jax.Array
) -> dict[str, jax.Array]:
    """Returns the states (n - 1, chambers) of terms of the chambers, at the times t[1:] [s]."""
    p = chamber_history(model, start_chambers(model), t).p
    p_set = set_pressures(model, t).b1
    none = jnp.zeros((0, *p.shape))
    x = Chamber(p, p_set, jnp.ones(()), rear_of(p.shape[-1]), jnp.sign(p), none)
    return {name: term.state(x) for name, term in terms.items()}


def _visited_sections(plan: TrialPlan, model: Model) -> list[Section]:
    h = jnp.asarray(plan.grid.h)

    def advance(done: int, carry):
        t0 = jnp.asarray(plan.grid.h * done)
        return advance_chunk(model, h, t0, carry, _section, plan.numerics, plan.scheme, BLOCK)

    return run_chunks(advance, at_rest(model, plan.numerics), plan.grid.steps, BLOCK)[0]


def _in_parts(term: Any, z: np.ndarray, section: Section) -> dict[str, np.ndarray]:
    """Returns the states `z` (steps, cells) of a term by part of the robot."""
    if set(term.priors()) == set(PARTS):
        tail = np.asarray(section.in_tail[0]) > 0.5
        return {"body": z[:, ~tail].ravel(), "tail": z[:, tail].ravel()}
    acts = np.asarray(term.cells(section)[0]) > 0.5
    return {"": z[:, acts].ravel()}


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
