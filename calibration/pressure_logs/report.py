"""report.json of a loop closed on the rig's logs: as of trials, and what it means for thrust."""

from collections.abc import Callable, Sequence
from typing import Any

from calibration.discrepancy.close_loop import Outcome
from calibration.discrepancy.report import report
from calibration.pressure_logs.read import PA_PER_PSI, ManifoldLog
from calibration.pressure_logs.thrust_change import compared
from slider_jax.io.provenance import input_file
from slider_jax.paper import PRESSURE_LAG


def log_report(
    outcome: Outcome, logs: Sequence[ManifoldLog], seconds: Callable[[], float]
) -> dict[str, Any]:
    """The content of report.json; `seconds()` since the loop began."""
    inputs = [input_file(log.path) for log in logs]
    told = report(outcome, 0.0, {"logs": inputs})
    told["errors_psi"] = {
        part: {c: {k: v / PA_PER_PSI for k, v in row.items()} for c, row in told[part].items()}
        for part in ("errors", "held_out")
    }
    told["consequence"] = consequence_of(outcome)
    told["seconds"] = seconds()
    return told


def consequence_of(outcome: Outcome) -> dict[str, Any]:
    """Thrust at 4.8 Hz with the paper's lag, with the lag that fits best, and with the effects."""
    labels = [p.label for p in outcome.entries]
    k = labels.index("k")
    effects = []
    for name in outcome.effects:
        values = {
            p.name: float(x)
            for p, x in zip(outcome.entries, outcome.final.theta, strict=True)
            if p.effect == name
        }
        effects.append({"name": name, **values})
    return compared(
        {
            "lag of the paper": ({"k": PRESSURE_LAG}, []),
            "lag that fits the logs best": ({"k": float(outcome.search.base.theta[k])}, []),
            "with what was found": ({"k": float(outcome.final.theta[k])}, effects),
        }
    )
