"""`slider lamprey`: the model's axial force on a swimming animal, from measured midlines."""

import sys
import time
from pathlib import Path
from typing import Annotated

import tyro

from slider_jax.cli.options import Folder, Whole


def lamprey(
    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FOLDER")],
    out: Folder,
    draws: Whole = 400,
    seed: Whole = 0,
) -> None:
    """Prescribe an animal's midlines, balance the axial force, and trace what it lacks.

    FOLDER holds lampreydata.csv (t, frame, point, mxmm, mymm) and fishwidth.csv (s, ammowidth).
    Writes DIR/report.html (to read) and DIR/report.json (to process).

    Args:
        folder: the folder of the two files.
        out: folder for the results; made if missing, files of the same name are replaced.
        draws: how many alternatives make the intervals, 20 or more.
        seed: of the draws.
    """
    from calibration.lamprey.balance import weigh
    from calibration.lamprey.report import animal_page, animal_record, balance_table
    from slider_jax.errors import InputError
    from slider_jax.io.files import input_file, staged, write_json, write_text

    if draws < 20:
        raise InputError.value("--draws", draws, "20 or more")
    begun = time.monotonic()
    print("drawing what one animal leaves open (half a minute) ...", file=sys.stderr, flush=True)
    with staged(out) as stage:
        found = weigh(folder, seed, draws)
        sources = [input_file(folder / name) for name in ("lampreydata.csv", "fishwidth.csv")]
        content = animal_record(found, time.monotonic() - begun, sources)
        write_json(stage / "report.json", content)
        write_text(stage / "report.html", animal_page(found, content))
    print(balance_table(found))
    print(content["said"])
    print(f"report.html and report.json are in {out}", file=sys.stderr)
