"""report.json of a loop closed on the rig's logs: as of trials, and what it means for thrust."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from calibration.discrepancy.close_loop import LoopOutcome
from calibration.discrepancy.report import loop_record
from calibration.pressure_logs.read import PA_PER_PSI, ManifoldLog
from slider_jax.experiment.load import Experiment, assemble
from slider_jax.io.files import input_file
from slider_jax.observables.strides import stride_means
from slider_jax.paper import PRESSURE_LAG
from slider_jax.simulation.effect_signature import FREQUENCY, built_in_experiment
from slider_jax.simulation.trial import simulate_trial


class Consequence(NamedTuple):
    """The built-in robot's last stride at `FREQUENCY`, for one pressure model."""

    mean_thrust_N: float
    recoil_rms_N: float
    tip_half_range_m: float
    pressure_half_range_Pa: float
    """Of the front chamber."""


def consequence(parameters: Mapping[str, float], effects: list[dict]) -> Consequence:
    """Run the built-in robot with its square wave, `parameters` and `effects` replaced.

    Both as an experiment file has them. Raises `SolverError` where a step fails.
    """
    experiment = built_in_experiment()
    content = experiment.model_dump() | {"effects": effects}
    content["parameters"] = content["parameters"] | dict(parameters)
    return _last_stride(assemble(content, "built-in robot", experiment.folder))


def _last_stride(experiment: Experiment) -> Consequence:
    run = simulate_trial(experiment)
    half = run.grid.half_period
    assert half is not None
    last = slice(len(run.t) - 2 * half, len(run.t))
    thrust = stride_means(jnp.asarray(run.series["thrust"][1:]), 2 * half)
    return Consequence(
        float(thrust[-1]),
        float(np.sqrt(np.mean(run.series["recoil"][last] ** 2))),
        0.5 * float(np.ptp(run.series["tip"][last])),
        0.5 * float(np.ptp(run.series["p_front"][last])),
    )


def compared(models: Mapping[str, tuple[Mapping[str, float], list[dict]]]) -> dict:
    """`consequence` of several models by name, with the drive that they share."""
    trial = built_in_experiment().trials[0]
    return {
        "frequency_Hz": FREQUENCY,
        "waveform": trial.waveform,
        "amplitude_Pa": trial.amplitude,
        "robot": "built-in",
        **{name: consequence(*model)._asdict() for name, model in models.items()},
    }


def log_report(
    outcome: LoopOutcome, logs: Sequence[ManifoldLog], seconds: Callable[[], float]
) -> dict[str, Any]:
    """The content of report.json; `seconds()` since the loop began."""
    inputs = [input_file(log.path) for log in logs]
    told = loop_record(outcome, 0.0, {"logs": inputs})
    told["errors_psi"] = {
        part: {c: {k: v / PA_PER_PSI for k, v in row.items()} for c, row in told[part].items()}
        for part in ("errors", "held_out")
    }
    told["consequence"] = consequence_of(outcome)
    told["seconds"] = seconds()
    return told


def consequence_of(outcome: LoopOutcome) -> dict[str, Any]:
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
