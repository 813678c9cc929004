"""Fronts of one tail for swimming and climbing, as in multimodal.json."""

from slider_jax.optimise.two_tasks import NAMES


def front_of(betas, sudden=False):
    """A multimodal.json in which all variables change from 0.5 to 1, evenly or in one step."""
    rows = []
    for i in range(betas):
        beta = i / (betas - 1)
        value = 0.5 + 0.5 * (float(i > 1) if sudden else beta)
        rows.append(
            {"beta": beta, "E_swim": 0.2 * value, "E_climb": 0.8, **dict.fromkeys(NAMES, value)}
        )
    bounds = dict.fromkeys(NAMES, [0.0, 1.0])
    only = {"E_swim": 0.2, "E_climb": 0.8}
    return {
        "front": rows,
        "only": only,
        "alone": only,
        "settings": {"bounds": bounds},
        "inputs": [],
    }
