"""`slider demo`: simulates the paper's head-fixed frequency sweep, without an input file."""

import sys
import time
from pathlib import Path

from slider_jax.cli.options import Folder


def demo(out: Folder = Path("slider_demo")) -> None:
    """Simulates the head-fixed frequency sweep of the paper and compares the results.

    The sweep has 34 frequencies from 0.4 to 7.0 Hz. The command writes sweep.csv,
    thrust_against_frequency.png (like the paper's Fig. 4) and settings.json to DIR. For 1 Hz
    and 4.8 Hz, the command also writes series_*.csv and stride_*.png (like the paper's Figs. 5 and
    6). settings.json lists the positions and pressures of the chambers, which the paper does not
    state.

    Args:
        out: folder for the results; created if missing. Existing files are replaced.
    """
    from slider_jax.cli.progress import Progress
    from slider_jax.io.files import output_folder
    from slider_jax.reproduction.frequency_sweep import FrequencySweepSettings, run_frequency_sweep
    from slider_jax.reproduction.frequency_sweep_report import comparison, write_frequency_sweep

    output_folder(out)
    settings, started = FrequencySweepSettings(), time.perf_counter()
    with Progress(f"{len(settings.frequencies)} frequencies", "stride") as progress:
        sweep = run_frequency_sweep(settings, progress.begin, progress.step)
    write_frequency_sweep(sweep, settings, out)
    print(comparison(sweep, settings))
    seconds = time.perf_counter() - started
    print(f"wrote the results to {out} ({seconds:.0f} s)", file=sys.stderr)
