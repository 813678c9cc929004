"""`slider rig loop`: measure, find what the model lacks, choose the next trial, measure again."""

import sys
import time
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import tyro

from rig.cli.shared import (
    Port,
    RigFile,
    StatusLine,
    declare_swing,
    install_experiment,
    open_rig,
    planned_trial,
    with_force_counts,
)
from slider_jax.cli.options import Folder, Range, Whole
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
    """Measure, find what the model lacks, add the trial that tells most, until it is settled.

    DIR/measured becomes the experiment's folder with all trials, DIR/round_NN.json what was found
    with each number of trials, DIR/report.html, report.json and model.toml the last word. A loop
    that was stopped goes on when it is started again. Nothing of the rig moves while the model
    computes; the manifold is vented.

    Args:
        experiment: experiment file; its trials, three or more, are run first.
        port: serial port of the manifold.
        out: folder for all of it; made if missing.
        rig: TOML file of the rig: limits, pace, force sensor, analogue inputs.
        budget: most trials, with those of the file.
        frequency: lowest and highest frequency of the trials that are added, Hz; by default those
            of the file, a tenth wider. So with the next two.
        amplitude: lowest and highest set pressure of theirs, Pa; never above the rig's limits.
        phase: lowest and highest phase of the rear chamber of theirs, fraction of a period.
    """
    from calibration.discrepancy.page import loop_page
    from calibration.discrepancy.report import loop_model_toml
    from calibration.discrepancy.settings import DEFAULT_SETTINGS
    from calibration.experiment_design.campaign import campaign
    from calibration.experiment_design.trial_search import TrialLimits, limits_of
    from rig.cli.settings import load_rig
    from rig.trial.session import run_trials
    from slider_jax.experiment.load import Experiment, load
    from slider_jax.experiment.schema import Trial
    from slider_jax.io.files import output_folder, write_json, write_text

    settings = load_rig(rig)
    given = load(experiment)
    if len(given.trials) < DEFAULT_SETTINGS.min_trials:
        raise InputError.value(
            f"{experiment}: trials",
            len(given.trials),
            f"{DEFAULT_SETTINGS.min_trials} or more to begin with",
        )
    if any(trial.clamp_moves or trial.tow_speed for trial in given.trials):
        raise InputError(f"{experiment}: a clamp moves; allowed trials whose clamp rests")
    allowed = {"frequency": frequency, "amplitude": amplitude, "phase": phase}
    allowed["tow_speed"] = (0.0, 0.0)

    def within(now: Experiment) -> TrialLimits:
        highest = min(settings.manifold.limits)
        behind = max([1.0, *(abs(t.rear_ratio) for t in now.trials)])
        own = limits_of(now, allowed)
        low, high = own.amplitude
        return own._replace(amplitude=(min(low, highest / behind), min(high, highest / behind)))

    within(given)  # ranges that cannot be are told at once
    settings = with_force_counts(settings)
    folder = output_folder(out) / "measured"
    folder.mkdir(exist_ok=True)
    path = folder / "experiment.toml"
    install_experiment(experiment, folder)
    begun = time.monotonic()

    def say(text: str) -> None:
        print(f"{time.monotonic() - begun:6.0f} s  {text}", file=sys.stderr, flush=True)

    def capture(trials: tuple[Trial, ...]) -> None:
        # Opened anew for each round: between them the manifold is vented and its port free.
        with ExitStack() as stack:
            machine = stack.enter_context(open_rig(port, settings))
            played = [planned_trial(trial, path) for trial in trials]
            live = StatusLine(machine, len(played))
            told = {"rig": settings.model_dump(mode="json")}
            found = run_trials(played, machine, folder, told, live)
            live.end()
        declare_swing(path, found)

    found = campaign(path, capture, out, budget, within, say)
    rounds = {"rounds": [asdict(x) for x in found.rounds], "settled": found.settled}
    write_json(out / "report.json", found.report | rounds)
    write_text(out / "model.toml", loop_model_toml(found.outcome))
    write_text(out / "report.html", loop_page(found.outcome, found.report))
    for x in found.rounds:
        print(f"{x.trials:2} trials: {x.said}")
    print("settled" if found.settled else f"not settled with {found.rounds[-1].trials} trials")
