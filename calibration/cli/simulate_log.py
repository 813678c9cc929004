"""`slider simulate LOG.txt`: simulates the built-in robot with a pressure log of the rig."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from calibration.pressure_logs.problem import log_experiment
from calibration.pressure_logs.read import PA_PER_PSI, ManifoldLog, read_log
from calibration.pressure_logs.residual_shape import whole_cycles
from slider_jax.actuation import FirstOrderLag, Recorded
from slider_jax.channels import TIME
from slider_jax.cli.progress import Progress
from slider_jax.dynamics.model import Drive
from slider_jax.dynamics.step import Carry, at_rest
from slider_jax.errors import SolverError
from slider_jax.experiment.load import Experiment, drag_and_added_mass
from slider_jax.experiment.prepare import divided_step, prepare
from slider_jax.io.files import input_file, provenance, staged, write_csv, write_json
from slider_jax.simulation.trial import SavedSeries, advance_chunk, run_chunks

CHUNK = 125
"""Number of samples per call of the compiled program."""
NUMERICS = {"step": 1e-3}
"""Longest time step [s]. The sampling period of the log is a multiple of the actual step. For a log
at 3 Hz, the results with steps of 1 ms and 0.25 ms differ by 0.4 % of the thrust's standard
deviation and by 0.1 % of the recoil's standard deviation, for both values of `drive`."""

DEFINITIONS = {
    "mapping": "the log contains the gauge pressure of one chamber. In the simulation, the front "
    "and the rear chamber both have this pressure, so both chambers bend the body to the same side",
    "start": "the robot starts straight and at rest. The initial pressure is the first measured "
    "sample. The first cycle contains the transient from rest",
    "averaged": "averages are computed over the log's whole cycles after the first cycle",
}


def simulate_log(
    path: Path, model: Path | None, out: Path, drive: Literal["set", "measured"], plot: bool
) -> None:
    """Simulates the robot with a pressure log; writes `out`/<name of the log>.csv and summary.json.

    The CSV file has the log's sample times. With `drive` "set", the pressure starts at the first
    measured sample and follows the command with the lag. With `drive` "measured", the measured
    pressure drives the robot. Raises `InputError` for invalid files, and `SolverError` if a step
    does not converge.
    """
    log = read_log(path)
    for finding in log.findings:
        print(f"{path.name}: {finding}", file=sys.stderr)
    experiment = log_experiment(log, model, NUMERICS)
    with staged(out) as stage:
        with Progress(path.stem, "sample") as progress:
            columns = drive_robot(log, experiment, drive, progress.to)
        formats = {TIME: ".3f"} | {x.column: x.digits for x in experiment.channels.values()}
        write_csv(stage / f"{path.stem}.csv", columns, formats)
        record = log_summary(log, experiment, model, drive, columns)
        write_json(stage / "summary.json", record)
        if plot:
            from calibration.pressure_logs.plots import plot_driven

            plot_driven(log, columns, stage / f"{path.stem}.png")
    print(
        f"{path.stem}: mean thrust {1e3 * record['mean_thrust_N']:.2f} mN, recoil "
        f"{1e3 * record['recoil_rms_N']:.1f} mN rms, "
        f"tip +-{1e3 * record['tip_half_range_m']:.2f} mm; "
        f"rms error of the pressure {record['pressure_rmse_psi']:.2f} psi; "
        f"{path.stem}.csv and summary.json are in {out}",
        file=sys.stderr,
    )


def drive_robot(
    log: ManifoldLog, experiment: Experiment, drive: str, progress=lambda done, total: None
) -> dict[str, np.ndarray]:
    """Returns the simulated readings at the log's sample times, as the columns of a trial file.

    Missing samples of the drive are interpolated linearly. The function calls `progress` with the
    number of finished samples and the number of all samples.
    """
    source = log.pressure_Pa if drive == "measured" else log.command_Pa
    count = round(log.t[-1] / log.period)
    whole = -(-count // CHUNK) * CHUNK
    at = log.period * np.arange(whole + 1)
    set_point = np.interp(at, log.t, source)
    prepared = prepare(experiment, sample_times=log.t, declared_drive=True)
    h = divided_step(log.period, experiment.numerics.step)
    every = round(log.period / h)
    base, numerics = prepared.model, prepared.numerics
    if drive == "measured":  # with lag 0, both values of `drive` share one compiled program
        base = replace(base, pressure_law=FirstOrderLag(jnp.asarray(0.0, float)))
    start = jnp.asarray(log.pressure_Pa[0])
    base = replace(base, drive=replace(base.drive, start=start))
    save = SavedSeries(prepared.channels)

    def advance(first: int, carry: Carry):
        span = slice(first, first + CHUNK + 1)
        wave = Recorded(jnp.asarray(at[span]), jnp.asarray(set_point[span]))
        model, t0 = (
            replace(base, drive=Drive((wave,) * len(base.drive.waves))),
            jnp.asarray(at[first]),
        )
        saved, carry = advance_chunk(
            model, jnp.asarray(h), t0, carry, save, numerics, prepared.scheme, CHUNK * every
        )
        return jax.tree.map(lambda x: np.asarray(x)[every - 1 :: every], saved), carry

    def after(done: int, saved, carry: Carry) -> None:
        failed_at = float(carry.failed_at)
        if failed_at < log.t[-1] + 0.5 * h or not np.isfinite(saved["recoil"]).all():
            raise SolverError(
                f"{log.path}: the step to t = {min(failed_at, at[done]):.6g} s (length "
                f"{h:.3g} s) did not converge. The bending moment may be too large for the body; "
                "check K_Q, stiffness and lag in the model file"
            )
        progress(min(done + 1, len(log.t)), len(log.t))

    parts, _ = run_chunks(advance, at_rest(base, numerics), whole, CHUNK, after)
    initial = save.start(base, np.zeros((2, 1)))
    series = {
        name: np.concatenate([first[None], *(part[name] for part in parts)])
        for name, first in initial.items()
    }
    true = {name: jnp.asarray(values) for name, values in series.items()}
    channels = prepared.channels
    readings = channels.recorded(base.effects, jnp.asarray(at), true)
    kept = np.round(log.t / log.period).astype(int)
    columns = {channel.column: np.asarray(readings[x])[kept] for x, channel in channels.items()}
    return {TIME: log.t} | columns


def log_summary(
    log: ManifoldLog,
    experiment: Experiment,
    model: Path | None,
    drive: str,
    columns: dict[str, np.ndarray],
) -> dict[str, Any]:
    """Returns the content of summary.json."""
    here = whole_cycles(log)
    thrust, recoil, tip = (columns[name][here] for name in ("thrust_N", "recoil_N", "tip_m"))
    error = (columns["p_front_Pa"] - log.pressure_Pa) / PA_PER_PSI
    C_d, m_a = drag_and_added_mass(experiment, experiment.trials[0])
    return {
        "name": log.path.stem,
        "input": input_file(log.path),
        "model": None if model is None else input_file(model),
        "drive": {
            "set": "the command, filtered by the pressure lag",
            "measured": "the measured pressure with its sensor noise",
        }[drive],
        "frequency_Hz": log.frequency,
        "samples": len(log.t),
        "sampling_s": log.period,
        "averaged_cycles": round(float(np.sum(here)) * log.period * log.frequency),
        "mean_thrust_N": thrust.mean(),
        "recoil_rms_N": np.sqrt(np.mean(recoil**2)),
        "tip_half_range_m": 0.5 * np.ptp(tip),
        "pressure_rmse_psi": np.sqrt(np.mean(error**2)),
        "C_d": C_d,
        "m_a": m_a,
        "force_coefficients": "the paper's ramp at the log's frequency"
        if experiment.parameters.force_coefficients == "ramp"
        else "from the model file",
        "definitions": DEFINITIONS,
        "findings": [str(finding) for finding in log.findings],
        "seed": None,
        **provenance(),
        "settings": experiment.model_dump(),
    }
