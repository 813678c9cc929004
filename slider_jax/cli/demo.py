"""`slider demo`: the paper's head-fixed frequency sweep, with no input."""

import sys
import time
from pathlib import Path

from slider_jax.cli.options import Folder


def demo(out: Folder = Path("slider_demo")) -> None:
    """Run the paper's head-fixed sweep, 0.4 to 7.0 Hz in 34 steps, and compare.

    DIR gets sweep.csv, thrust_against_frequency.png (as the paper's Fig. 4), and for 1 and 4.8 Hz
    series_*.csv and stride_*.png (as its Figs. 5 and 6), and settings.json. The chambers' spans and
    pressures, which the paper leaves out, are assumed; the settings say so.

    Args:
        out: folder for the results; made if missing, files of the same name are replaced.
    """
    from slider_jax.cli.progress import Progress
    from slider_jax.io.files import output_folder
    from slider_jax.reproduction.frequency_sweep import FrequencySweepSettings, run_frequency_sweep
    from slider_jax.reproduction.frequency_sweep_report import comparison, write_frequency_sweep

    output_folder(out)
    settings, begun = FrequencySweepSettings(), time.perf_counter()
    with Progress(f"{len(settings.frequencies)} frequencies", "stride") as progress:
        sweep = run_frequency_sweep(settings, progress.begin, progress.step)
    write_frequency_sweep(sweep, settings, out)
    print(comparison(sweep, settings))
    seconds = time.perf_counter() - begun
    print(f"results are in {out} ({seconds:.0f} s)", file=sys.stderr)
