"""`slider rig loop`: measures trials, searches for missing effects, and adds the next trial."""

from pathlib import Path
from typing import Annotated

import tyro

from rig.cli.shared import (
    Port,
    RigFile,
    StatusLine,
    declare_swing,
    install_experiment,
    layout_in,
    open_rig,
    planned_trial,
    with_force_counts,
)
from rig.manifold.limits import PressureLimits
from slider_jax.cli.options import Folder, Range, Whole
from slider_jax.cli.progress import timed_printer
from slider_jax.errors import InputError


def rig_loop(
    experiment: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="EXPERIMENT.toml")],
    port: Port,
    out: Folder,
    rig: RigFile = None,
    budget: Whole = 12,
    frequency: Range = None,
    amplitude: Range = None,
    phase: Range = None,
) -> None:
    """Measures trials, searches for missing effects, and adds the most informative trial.

    The command repeats these steps until the verdict is final or all trials of the budget are
    measured. DIR/measured is the folder of the experiment with all trials. DIR/round_NN.json
    contains the result of round NN. DIR/report.html, report.json and model.toml contain the result
    of the last round. To resume an interrupted loop, repeat the command. All chambers vent during
    computations.

    Args:
        experiment: experiment file with three or more trials. The rig runs these trials first.
        port: serial port of the manifold; `slider rig ports` lists all serial ports.
        out: folder for the results; created if missing.
        rig: TOML file of the rig: limits, command rate, pauses and sensors.
        budget: largest number of trials, including those of the experiment file.
        frequency: lowest and highest frequency of added trials, in Hz (default: the range of the
            file's trials, widened by a tenth).
        amplitude: lowest and highest set pressure of added trials, in Pa, up to the rig's limits
            (default: the range of the file's trials, widened by a tenth).
        phase: lowest and highest phase of the last chamber in added trials, as a fraction of a
            period (default: the range of the file's trials, widened by a tenth).
    """
    from calibration.discrepancy.page import loop_page
    from calibration.discrepancy.report import loop_model_toml
    from calibration.discrepancy.settings import DEFAULT_SETTINGS
    from calibration.experiment_design.campaign import run_campaign
    from calibration.experiment_design.trial_search import TrialLimits, limits_of
    from rig.cli.settings import load_rig
    from rig.trial.session import run_trials
    from slider_jax.experiment.load import Experiment, load
    from slider_jax.experiment.schema import Trial
    from slider_jax.io.files import output_folder, write_json, write_text

    settings = load_rig(rig)
    given = load(experiment)
    chambers = layout_in(experiment)
    limits = PressureLimits.of(settings.manifold.limits, chambers, f"{rig}: manifold.limits")
    if len(given.trials) < DEFAULT_SETTINGS.min_trials:
        raise InputError.value(
            f"{experiment}: trials", len(given.trials), f"{DEFAULT_SETTINGS.min_trials} or more"
        )
    if any(trial.clamp_moves or trial.tow_speed for trial in given.trials):
        raise InputError(
            f"{experiment}: the clamp of a trial moves or is towed; only fixed clamps are allowed; "
            "remove this trial"
        )
    allowed = {"frequency": frequency, "amplitude": amplitude, "phase": phase}
    allowed["tow_speed"] = (0.0, 0.0)

    def within(now: Experiment) -> TrialLimits:
        # The pressures of a chamber are its ratio times the amplitude, and its bias.
        ratios = [abs(x) for t in now.trials for x in (t.rear_ratio, *(t.ratios or ()))]
        bias = max([0.0, *(abs(x) for t in now.trials for x in t.biases or ())])
        highest = (min(limits.pressures) - bias) / max(1.0, *ratios)
        if highest < 1e3:
            allowed_bias = f"at most {min(limits.pressures) - 1e3:g} Pa, below the lowest limit"
            raise InputError.value(f"{experiment}: largest bias", f"{bias:g}", allowed_bias)
        ranges = limits_of(now, allowed)
        low, high = ranges.amplitude
        return ranges._replace(amplitude=(min(low, highest), min(high, highest)))

    within(given)  # refuses invalid ranges before the rig moves
    settings = with_force_counts(settings)
    folder = output_folder(out) / "measured"
    folder.mkdir(exist_ok=True)
    path = folder / "experiment.toml"
    install_experiment(experiment, folder)

    def capture(trials: tuple[Trial, ...]) -> None:
        # The rig is opened for each round. Between rounds, all chambers vent; the port is closed.
        layout = layout_in(path)
        with open_rig(port, settings, layout) as machine:
            planned = [planned_trial(trial, layout, path) for trial in trials]
            live = StatusLine(machine, len(planned), layout)
            stored = {"rig": settings.model_dump(mode="json")}
            records = run_trials(planned, machine, folder, stored, live)
            live.end()
        declare_swing(path, records)

    found = run_campaign(path, capture, out, budget, within, timed_printer())
    rounds = {"rounds": found.rounds, "settled": found.settled}
    write_json(out / "report.json", found.report | rounds)
    write_text(out / "model.toml", loop_model_toml(found.outcome))
    write_text(out / "report.html", loop_page(found.outcome, found.report))
    for x in found.rounds:
        print(f"{x['trials']:2} trials: {x['said']}")
    final = "is final" if found.settled else "is not final"
    print(f"with {found.rounds[-1]['trials']} trials, the verdict {final}")
