"""Checks the paper's statements on Fig. 9 with a finished front of `slider optimize multimodal`."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from slider_jax import paper
from slider_jax.errors import InputError
from slider_jax.io.files import input_file
from slider_jax.optimise.report import CONVERGED
from slider_jax.optimise.two_tasks import NAMES
from slider_jax.statements.statements import MISSED, OMITTED, REPRODUCED, Simulated
from slider_jax.statements.verdicts import Judgement, interval_text

inf = float("inf")
FIG_9 = "Fig. 9"
STEP, SUDDEN = 0.25, 0.5
"""The optimal values shift rapidly if at least the fraction `SUDDEN` of their whole change is in
one step of beta, which is at most `STEP`. The paper gives no number."""
OF_FRONT: dict[str, Simulated] = {
    "weight_changes_tail": Simulated(
        FIG_9, "The optimal tail depends on the weight beta of swimming.", "tail_change",
        paper.NEAR, inf, "%", 100.0, "larger relative change of length and EI from beta = 0 to 1",
    ),
    "weight_changes_drive": Simulated(
        FIG_9, "The optimal actuation depends on the weight beta of swimming.", "drive_change",
        paper.NEAR, inf, "%", 100.0,
        "largest relative change of a frequency or pressure from beta = 0 to 1",
    ),
    "rapid_shift": Simulated(
        FIG_9, "The optimal values shift rapidly within a range of beta.", "largest_step_share",
        SUDDEN, inf, "%", 100.0,
        f"part of the whole change in one step of beta; a step is at most {STEP:g}",
    ),
}  # fmt: skip
HOW = (
    "run `slider optimize multimodal --out DIR` (about seven minutes on two cores), and add "
    "`--front DIR` to `slider published --all`"
)


def load_front(folder: Path) -> dict[str, Any]:
    """Returns the content of multimodal.json in `folder`, with path and digest of the file.

    Raises `InputError` if the file is missing, if it belongs to another robot than the built-in
    one, if its steps of beta are too large, or if its search was too short. A short search finds
    the same design for many values of beta, and so always a sudden shift.
    """
    path = folder / "multimodal.json"
    if not path.is_file():
        raise InputError(
            f"--front {folder}: multimodal.json is missing; write it with `slider optimize "
            f"multimodal --out {folder}`"
        )
    content = json.loads(path.read_text(encoding="utf-8"))
    if content["inputs"]:
        raise InputError(
            f"{path}: the front belongs to {content['inputs'][0]['path']}; allowed is a front of "
            "the built-in robot, which `slider optimize multimodal` computes without an experiment"
        )
    steps = np.diff([x["beta"] for x in content["front"]])
    if not 0.0 < steps.max() <= STEP + 1e-9:
        raise InputError.value(
            f"{path}: step of beta", f"{steps.max():.3g}", f"at most {STEP:g}", "use --betas 5"
        )
    for name, alone in content["alone"].items():
        if alone < CONVERGED * content["only"][name]:
            raise InputError(
                f"{path}: the optimisation of {name} alone reached {alone:.3g}, less than "
                f"{CONVERGED:g} of the {content['only'][name]:.3g} of a later optimisation; repeat "
                "`slider optimize multimodal` with more --generations in a new folder"
            )
    return content | {"file": input_file(path)}


def front_facts(content: dict[str, Any]) -> dict[str, float]:
    """Returns the numbers that `OF_FRONT` uses, by name, from the content of multimodal.json."""
    bounds, rows = content["settings"]["bounds"], content["front"]
    steps = []
    for name in NAMES:
        low, high = bounds[name]
        change = np.abs(np.diff([x[name] for x in rows])) / (high - low)
        # A phase is a fraction of a period, so 0.5 and -0.5 are the same.
        steps.append(np.minimum(change, 1.0 - change) if name.endswith("phase") else change)
    by_step = np.sum(steps, axis=0)
    whole = by_step.sum()

    def largest_change(names: tuple[str, ...]) -> float:
        ends = np.array([[x[name] for name in names] for x in (rows[0], rows[-1])])
        return float(np.max(np.abs(ends[1] - ends[0]) / np.max(ends, axis=0)))

    drives = tuple(x for x in NAMES if x.endswith(("frequency", "front", "rear")))
    return {
        "tail_change": largest_change(("tail_length", "EI_tail")),
        "drive_change": largest_change(drives),
        "largest_step_share": float(by_step.max() / whole) if whole > 0.0 else float("nan"),
    }


def judged_front(content: dict[str, Any] | None) -> list[Judgement]:
    """Returns the verdicts on the statements on Fig. 9; None if no front is available."""
    found = front_facts(content) if content else {}
    rows = []
    for name, one in OF_FRONT.items():
        value = found.get(one.fact)
        verdict = OMITTED if value is None else REPRODUCED if one.agrees(value) else MISSED
        rows.append(
            Judgement(name, "multimodal", one.place, one.text,
                      interval_text(one.low * one.factor, one.high * one.factor), one.unit,
                      None if value is None else one.factor * value, None, verdict,
                      HOW if value is None else one.reading)
        )  # fmt: skip
    return rows
