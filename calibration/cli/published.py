"""`slider published`: the paper's free-swimming speeds against its own equations."""

import sys
import time

from slider_jax.cli.options import Folder


def published(out: Folder) -> None:
    """Free-swimming speeds of the paper: its equations, and what an effect that resists predicts.

    Each effect is calibrated on one published speed and predicts the other. Takes some minutes.
    Writes DIR/report.html (to read) and DIR/report.json (to process).

    Args:
        out: folder for the results; made if missing, files of the same name are replaced.
    """
    from calibration.free_swimming.published_speeds import FIRST, OPTIMUM, After, after, before
    from calibration.free_swimming.report import (
        CrossPrediction,
        speeds_page,
        speeds_record,
        speeds_table,
    )
    from slider_jax.io.files import staged, write_json, write_text

    begun = time.monotonic()

    def say(line: str) -> None:
        print(f"{time.monotonic() - begun:5.0f} s  {line}", file=sys.stderr, flush=True)

    def done(a: After) -> None:
        say(f"{a.resisting} from {a.calibrated_on}: {100 * a.predicted:.1f} cm/s at {a.predicts}")

    with staged(out) as stage:
        say("from rest by the paper's equations")
        alone = before()
        outcome = CrossPrediction(
            alone, after(FIRST, OPTIMUM, done=done), after(OPTIMUM, FIRST, done=done)
        )
        content = speeds_record(outcome, time.monotonic() - begun)
        write_json(stage / "report.json", content)
        write_text(stage / "report.html", speeds_page(outcome, content))
    print(speeds_table(outcome))
    print(content["said"])
    print(f"report.html and report.json are in {out}", file=sys.stderr)
