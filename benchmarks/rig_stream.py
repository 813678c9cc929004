"""Measures how well a stream of 500 readings and 200 commands per second is recorded.

    python benchmarks/rig_stream.py [SECONDS]

A simulated manifold runs in a separate process behind a pseudo-terminal. The benchmark reports:

- the number of lost readings and of repeated readings (limit: 0);
- the delay until a command is written (limit: 5 ms for 99 of 100 commands);
- the fraction of a core that the host needs for driver, recorder and timing (limit: 15 %).
"""

import json
import platform
import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from rig.chambers import SLIDER
from rig.manifold.driver import Manifold
from rig.manifold.limits import PressureLimits
from rig.manifold.serial_port import open_port
from rig.recording.decode import decode_readings
from rig.recording.reader import read_recording
from rig.scheduling import real_time_priority
from rig.simulated.rig import SimulatedRig
from rig.simulated.tank import BenchTank
from rig.simulated.terminal import serve_in_process
from rig.trial.capture import ManifoldSinks, PlannedTrial, SwitchableSink, TrialTiming, record_trial
from rig.trial.waveform import ChamberDrive


def device() -> SimulatedRig:
    """Returns the simulated rig."""
    return SimulatedRig(BenchTank())


def _cpu() -> float:
    """Returns the processor time [s] of this process and of ended child processes."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + ended.ru_utime + ended.ru_stime


def measure(seconds: float, folder: Path) -> dict[str, float | int | str]:
    """Records a trial of `seconds` and returns the statistics of the stream."""
    path = folder / "stream.h5"
    switches = ManifoldSinks(SwitchableSink(), SwitchableSink())
    drive = ChamberDrive("sine", 1.3, 150e3, phases=(0.0, 0.15))
    with real_time_priority() as priority, serve_in_process(device) as served:
        with Manifold(open_port(served.path), *switches) as manifold:
            cpu, start = _cpu(), time.monotonic()
            captured = record_trial(
                PlannedTrial("stream", drive, seconds), manifold, switches, {}, path,
                PressureLimits.of([250e3], SLIDER.names), {}, TrialTiming(),
            )  # fmt: skip
            cpu, wall = _cpu() - cpu, time.monotonic() - start
            lost, doubled, damaged = manifold.lost, manifold.duplicated, manifold.damaged
    stream = read_recording(path).streams["manifold"]
    kept = decode_readings(zip(stream.host_ns.tolist(), stream.pieces(), strict=True))
    late = 1e3 * captured.played.lateness
    return {
        "seconds": seconds,
        "priority": priority,
        "readings": len(kept.seq),
        "readings_a_second": len(kept.seq) / wall,
        "lost": lost,
        "doubled": doubled,
        "damaged": damaged,
        "lost_in_recording": kept.lost,
        "commands": len(late),
        "command_to_wire_50_ms": float(np.percentile(late, 50)),
        "command_to_wire_99_ms": float(np.percentile(late, 99)),
        "command_to_wire_most_ms": float(late.max()),
        "cpu_share": cpu / wall,
        "slowest_flush_s": captured.load.slowest_flush,
        "machine": platform.platform(),
    }


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        asked = float(sys.argv[1]) if len(sys.argv) > 1 else 600.0
        print(json.dumps(measure(asked, Path(folder)), indent=2))
