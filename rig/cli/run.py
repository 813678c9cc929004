"""`slider rig run`: an experiment's trials on the rig."""

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
    with_force_counts,
)
from slider_jax.cli.options import Folder, Pressures
from slider_jax.errors import InputError

MAX_LOST = 0.01
"""Share of a trial's readings."""


def rig_run(
    experiment: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="EXPERIMENT.toml")],
    port: Port,
    out: Folder,
    rig: RigFile = None,
    limit: Pressures = None,
    force: Annotated[str | None, tyro.conf.arg(metavar="HOST")] = None,
) -> int:
    """Run every trial of an experiment, and record it.

    All chambers vent at the end, on Ctrl-C, on an error, when the port is lost, and, by the
    manifold's own watchdog, when this program or the computer dies. DIR becomes the experiment's
    folder as `slider calibrate` and `slider close-loop` take it: experiment.toml, to which what the
    tip swung by at rest is written where that declares less, and the trials' CSVs; in
    DIR/recordings is all that came, as it came. A run that was stopped goes on with the trials
    that are missing when it is started again. Exit code 1 if more than one reading in a hundred was
    lost in a trial.

    Args:
        experiment: experiment file; its [robot] and [parameters] have no say here.
        port: serial port of the manifold; `slider rig ports` lists them.
        out: folder for the measured experiment; made if missing.
        rig: TOML file of the rig: limits, pace, force sensor, analogue inputs.
        limit: highest set pressure [Pa] of all chambers, or of the four; 250e3 by default.
        force: address of an ATI Net F/T box; its other settings are the rig file's.
    """
    from rig.cli.settings import load_rig
    from rig.manifold.limits import PressureLimits
    from rig.trial.session import finished_record, run_trials
    from slider_jax.io.files import input_file, output_folder

    if out.resolve() == experiment.resolve().parent:
        raise InputError(f"--out {out}: is the experiment's own folder; give another")
    table, trials = load_trials(experiment)
    changes: dict[str, dict[str, Any]] = {}
    if limit is not None:
        PressureLimits.of(limit, "--limit")
        changes["manifold"] = {"limits": list(limit)}
    if force is not None:
        changes["force"] = {"host": force}
    settings = load_rig(rig, changes)
    for trial in table.trials:
        if trial.tow_speed or trial.clamp_moves:
            moves = "is towed" if trial.tow_speed else "moves"
            print(f"{trial.file}: its clamp {moves}: see to that", file=sys.stderr)
    settings = with_force_counts(settings)
    source = input_file(experiment)
    told = {"experiment_sha256": source["sha256"], "rig": settings.model_dump(mode="json")}
    with open_rig(port, settings) as machine:
        if not machine.readers and not machine.analogue:
            print("no --rig with sensors: pressures alone are measured", file=sys.stderr)
        ident = machine.manifold.ident
        assert ident is not None
        rate = table.sensors.sample_rate
        if "sensors" in table.model_fields_set and abs(rate - ident.rate) > 0.05 * ident.rate:
            raise InputError.value(
                f"{experiment}: sensors.sample_rate",
                f"{rate:g}",
                f"{ident.rate} Hz, the manifold's",
            )
        for shot in trials:
            shot.check(machine.limits.within(ident))
        folder = output_folder(out)
        # Nothing is written where a trial is refused; what was added at rest stays.
        for shot in trials:
            finished_record(folder, shot, told)
        install_experiment(experiment, folder)
        live = StatusLine(machine, len(trials))
        try:
            found = run_trials(trials, machine, folder, told, live)
        except KeyboardInterrupt as stopped:
            stopped.add_note(
                f"all chambers are told to vent; what was recorded is kept in {folder}, and the "
                "same command goes on"
            )
            raise
        live.end()
    declare_swing(folder / "experiment.toml", found)
    poor, length = 0, table.robot.body_length + table.robot.tail_length
    for told_of in found:
        findings = list(told_of["findings"])
        if (over := told_of["range"].get("tip_m", 0.0)) > 2.0 * length:
            findings.append(
                f"tip_m goes over {over:.3g} m, of a robot {length:.3g} m long: see to its scale "
                "in the rig file, then `slider rig replay --rig`"
            )
        said = "; ".join(findings) or "no findings"
        poor += told_of["readings_lost"] > MAX_LOST * told_of["readings"]
        print(f"{told_of['trial']}.csv  {told_of['rows']} rows, commands within "
              f"{1e3 * told_of['command_late_99_s']:.1f} ms: {said}")  # fmt: skip
    if poor:
        print(
            f"{poor} of {len(found)} trials lost more than one reading in a hundred: see to the "
            f"line, then measure them again into another --out",
            file=sys.stderr,
        )
        return 1
    print(f"experiment.toml and the trials are in {folder}: slider close-loop "
          f"{folder / 'experiment.toml'} --out ...", file=sys.stderr)  # fmt: skip
    return 0
