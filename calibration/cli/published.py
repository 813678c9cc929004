"""`slider published`: compares the paper's measured free-swimming speeds with simulated speeds."""

import sys
import time

from slider_jax.cli.options import Folder
from slider_jax.cli.progress import timed_printer


def published(out: Folder) -> None:
    """Compares the paper's two measured free-swimming speeds with simulated speeds.

    The command adds one effect at a time that resists axial motion. Each effect is calibrated on
    one measured speed and predicts the other measured speed. The command takes some minutes. The
    results are DIR/report.html and DIR/report.json.

    Args:
        out: folder for the results; created if missing. Files of the same name are replaced.
    """
    from calibration.free_swimming.published_speeds import (
        FIRST,
        OPTIMUM,
        SpeedPrediction,
        predicted_speeds,
        unresisted_swims,
    )
    from calibration.free_swimming.report import (
        CrossPrediction,
        speeds_page,
        speeds_record,
        speeds_table,
    )
    from slider_jax.io.files import staged, write_json, write_text

    start, progress = time.monotonic(), timed_printer()

    def done(x: SpeedPrediction) -> None:
        effect = f"{x.resisting} calibrated at {x.calibrated_on}"
        progress(f"{effect} predicts {100 * x.predicted:.1f} cm/s at {x.predicts}")

    with staged(out) as stage:
        progress("simulating from rest by the paper's equations")
        outcome = CrossPrediction(
            unresisted_swims(),
            predicted_speeds(FIRST, OPTIMUM, done=done),
            predicted_speeds(OPTIMUM, FIRST, done=done),
        )
        content = speeds_record(outcome, time.monotonic() - start)
        write_json(stage / "report.json", content)
        write_text(stage / "report.html", speeds_page(outcome, content))
    print(speeds_table(outcome))
    print(content["said"])
    print(f"report.html and report.json are in {out}", file=sys.stderr)
