"""Removes selected effects that increase the error in the held-out trials.

The held-out trials took no part in the selection and in the fits. The whitened sum of squares of a
held-out trial is S0 for the fit without the effect and S1 for the fit with the effect, both fitted
to the other trials. The growth is the mean of log(S1/S0) over the held-out trials. An effect is
vetoed if its growth exceeds `veto_growth` and `veto_errors` standard errors.

The standard error is for noise alone. Let d be the sum of squared changes of the n whitened
readings by the effect. White noise of the variance S0/n then gives S1 - S0 the standard deviation
2 sqrt(d S0/n), and log(S1/S0) the standard deviation 2 sqrt(d/(n S0)).
"""

from collections.abc import Callable

import numpy as np

from calibration.discrepancy.refits import Refits
from calibration.discrepancy.rounds import Growth, Selection, effect_entries
from calibration.inference.gauss_newton import Fit
from calibration.inference.problem import AbstractProblem, total


def held_out_growth(rest: AbstractProblem, without: Fit, with_it: Fit) -> Growth:
    """Returns the growth of the error in the trials of `rest` from one fit to another."""
    predicted = [rest.predict(fit.theta) for fit in (without, with_it)]
    white = rest.whiteners(predicted[0])
    before, after = (rest.residuals(y, white) for y in predicted)
    logs, variances = [], []
    for trial in sorted({i for i, _ in before}):
        keys = [key for key in before if key[0] == trial]
        S0, S1 = (max(total({key: r[key] for key in keys}), 1e-300) for r in (before, after))
        d = sum(float(np.nansum((after[key] - before[key]) ** 2)) for key in keys)
        logs.append(np.log(S1 / S0))
        variances.append(4.0 * d / (sum(len(before[key]) for key in keys) * S0))
    return Growth(float(np.mean(logs)), float(np.sqrt(np.sum(variances)) / len(logs)))


def veto_effects(
    found: Selection,
    problem: AbstractProblem,
    rest: AbstractProblem,
    progress: Callable[[str], None] = lambda text: None,
) -> None:
    """Removes vetoed effects from the selection `found`, the effect with the largest growth first.

    `problem` contains the trials of the selection, and `rest` the held-out trials.
    """
    white = problem.whiteners(found.base.predicted)
    refits = Refits(problem, found.entries, white, progress, found.settings)
    while found.effects:
        less = {name: _without(refits, found, name) for name in found.effects}
        growths = {n: held_out_growth(rest, fit, found.final) for n, fit in less.items()}
        name = max(growths, key=lambda n: growths[n].mean)
        if not growths[name].vetoes(found.settings):
            return
        progress(f"removing {name}: it increases the error in the held-out trials")
        found.vetoed[name] = growths[name]
        found.final = less[name]
        found.effects.remove(name)
        round_ = next(r for r in found.rounds if r.chosen == name)
        round_.chosen, round_.equivalent, round_.alternatives = None, [], {}
        round_.taken_out = name


def _without(refits: Refits, found: Selection, name: str) -> Fit:
    """Returns the fit to the trials of the selection without the effect `name`."""
    if found.effects == [name]:
        return found.base
    refits.progress(f"refitting without {name}")
    group = effect_entries(refits.entries)[name]
    free = found.final.free
    return refits.fit(refits.null(found.final.theta, group), free[~np.isin(free, group)])
