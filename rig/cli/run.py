"""`slider rig run`: runs an experiment's trials on the rig."""

import sys
from pathlib import Path
from typing import Annotated, Any

import tyro

from rig.cli.shared import (
    Port,
    RigFile,
    StatusLine,
    declare_swing,
    install_experiment,
    load_trials,
    open_rig,
    warn_of_missing_sensors,
    warn_of_moving_clamp,
    with_force_counts,
)
from slider_jax.cli.options import Folder, Pressures
from slider_jax.errors import InputError

MAX_LOST = 0.01
"""Largest accepted fraction of lost readings in a trial."""


def rig_run(
    experiment: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="EXPERIMENT.toml")],
    port: Port,
    out: Folder,
    rig: RigFile = None,
    limit: Pressures = None,
    force: Annotated[str | None, tyro.conf.arg(metavar="HOST", help_behavior_hint="")] = None,
) -> int:
    """Runs and records every trial of an experiment.

    All chambers vent at the end, on Ctrl-C, on an error and when the port is lost. If this program
    or the computer stops, the manifold's watchdog vents all chambers. The command writes the
    measured experiment to DIR: experiment.toml and the trials' CSV files, for `slider calibrate`
    and `slider close-loop`. If the tip swings at rest by more than twice the declared swing, the
    command writes the measured swing to experiment.toml. DIR/recordings contains all received
    bytes. To resume an interrupted run with the missing trials, repeat the command. The exit code
    is 1 if more than 1 % of a trial's readings were lost.

    Args:
        experiment: experiment file; its [robot] and [parameters] are not used.
        port: serial port of the manifold; `slider rig ports` lists all serial ports.
        out: folder for the measured experiment; created if missing.
        rig: TOML file of the rig: limits, command rate, pauses and sensors.
        limit: highest set pressure, in Pa: one value for all chambers, or one value for each
            chamber (default: the limits of the rig file, or 250e3).
        force: host name or address of an ATI Net F/T box (default: the host in the rig file).
    """
    from rig.cli.settings import load_rig
    from rig.manifold.limits import PressureLimits
    from rig.trial.session import finished_record, run_trials
    from slider_jax.io.files import input_file, output_folder

    if out.resolve() == experiment.resolve().parent:
        raise InputError(f"--out {out}: is the experiment's own folder; give another folder")
    table, trials = load_trials(experiment)
    layout = trials[0].drive.layout
    changes: dict[str, dict[str, Any]] = {}
    if limit is not None:
        PressureLimits.of(limit, layout, "--limit")
        changes["manifold"] = {"limits": list(limit)}
    if force is not None:
        changes["force"] = {"host": force}
    settings = load_rig(rig, changes)
    PressureLimits.of(settings.manifold.limits, layout, f"{rig}: manifold.limits")
    warn_of_missing_sensors(table, settings)
    for trial in table.trials:
        warn_of_moving_clamp(trial)
    settings = with_force_counts(settings)
    source = input_file(experiment)
    recorded = {"experiment_sha256": source["sha256"], "rig": settings.model_dump(mode="json")}
    with open_rig(port, settings, layout) as machine:
        if not machine.readers and not machine.analogue:
            print("only pressures are measured; --rig can add other sensors", file=sys.stderr)
        ident = machine.manifold.ident
        assert ident is not None
        limits = machine.limits.within(ident)
        rate = table.sensors.sample_rate
        if "sensors" in table.model_fields_set and abs(rate - ident.rate) > 0.05 * ident.rate:
            raise InputError.value(
                f"{experiment}: sensors.sample_rate",
                f"{rate:g}",
                f"{ident.rate} Hz, the manifold's",
            )
        for planned in trials:
            planned.check(limits)
        folder = output_folder(out)
        # This check comes before the first write: it refuses finished trials with other settings.
        for planned in trials:
            finished_record(folder, planned, recorded)
        install_experiment(experiment, folder)
        live = StatusLine(machine, len(trials), layout)
        try:
            records = run_trials(trials, machine, folder, recorded, live)
        except KeyboardInterrupt as stopped:
            stopped.add_note(
                f"all chambers vent; the recordings are kept in {folder}; repeat the command to "
                "resume the run"
            )
            raise
        live.end()
    declare_swing(folder / "experiment.toml", records)
    poor, length = 0, sum(table.robot.lengths)
    for record in records:
        findings = list(record["findings"])
        if (tip_range := record["range"].get("tip_m", 0.0)) > 2.0 * length:
            findings.append(
                f"the range of tip_m is {tip_range:.3g} m, but the robot is {length:.3g} m long: "
                "correct the scale in the rig file, then run `slider rig replay --rig`"
            )
        poor += record["readings_lost"] > MAX_LOST * record["readings"]
        late_ms = 1e3 * record["command_late_99_s"]
        print(
            f"{record['trial']}.csv  {record['rows']} rows, 99 % of commands at most "
            f"{late_ms:.1f} ms late; {'; '.join(findings) or 'no findings'}"
        )
    if poor:
        print(
            f"{poor} of {len(records)} trials lost more than 1 % of their readings: check the "
            "cable, then repeat the trials with another --out",
            file=sys.stderr,
        )
        return 1
    file = folder / "experiment.toml"
    print(
        f"experiment.toml and the trials are in {folder}; next, run: slider calibrate {file} --out "
        f"..., or with three trials or more: slider close-loop {file} --out ...",
        file=sys.stderr,
    )
    return 0
