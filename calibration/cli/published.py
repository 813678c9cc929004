"""`slider published`: compares the paper's statements with simulations."""

import sys
import time
from pathlib import Path
from typing import Annotated

import tyro

from slider_jax.cli.options import Folder, MaybeFolder
from slider_jax.cli.progress import timed_printer
from slider_jax.errors import InputError


def published(
    out: Folder,
    every_statement: Annotated[bool, tyro.conf.arg(name="all")] = False,
    front: MaybeFolder = None,
) -> None:
    """Compares the paper's two measured free-swimming speeds with simulated speeds.

    The command adds one effect at a time that resists axial motion. Each effect is calibrated on
    one measured speed and predicts the other measured speed. The command takes some minutes. The
    results are DIR/report.html and DIR/report.json.

    With --all, the command instead compares every statement of the paper with the built-in robot,
    and with a set of assumptions that was fitted to all statements. The results are
    DIR/published.html, DIR/published.json and figures. An interrupted run resumes when you repeat
    the command. The statements on Fig. 9, about one tail for swimming and climbing, need the
    results of `slider optimize multimodal`; --front names their folder.

    Args:
        out: folder for the results; created if missing. Files of the same name are replaced.
        every_statement: compare all statements of the paper (about seven minutes on two cores).
        front: results of `slider optimize multimodal` for the built-in robot, for --all (default:
            none; the statements on Fig. 9 are then not simulated).
    """
    if every_statement:
        _all_statements(out, front)
    elif front is not None:
        raise InputError(f"--front {front}: only --all compares Fig. 9; add --all")
    else:
        _speeds(out)


def _all_statements(out: Path, front: Path | None) -> None:
    from slider_jax.batch.chunks import available_cores
    from slider_jax.optimise.population import start_devices

    start_devices(available_cores())
    from calibration.reporting.statements import statements_page, statements_summary
    from slider_jax.io.files import output_folder
    from slider_jax.programs import source_digest
    from slider_jax.statements.multimodal import load_front
    from slider_jax.statements.report import write_comparison

    given = None if front is None else load_front(front)
    folder, digest = output_folder(out), source_digest()
    content = write_comparison(folder, statements_page, digest, timed_printer(), given)
    print(statements_summary(content))
    print(f"published.html, published.json and figures are in {out}", file=sys.stderr)


def _speeds(out: Path) -> None:
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
