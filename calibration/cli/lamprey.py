"""`slider lamprey`: computes the axial force on a swimming animal from its measured midlines."""

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
    """Compares the modelled axial force on a swimming animal with the animal's change of momentum.

    The model computes the force for the measured motion of the body. If force and change of
    momentum per time differ, the report states which effects would explain the difference. The
    command writes DIR/report.html and DIR/report.json.

    Args:
        folder: folder with lampreydata.csv (columns t, frame, point, mxmm, mymm) and fishwidth.csv
            (columns s, ammowidth).
        out: folder for the results; created if missing. Files of the same name are replaced.
        draws: number of random samples for the 95 % intervals, at least 20.
        seed: seed of the random samples.
    """
    from calibration.lamprey.balance import analyse_folder
    from calibration.lamprey.report import animal_page, animal_record, balance_table
    from slider_jax.errors import InputError
    from slider_jax.io.files import input_file, staged, write_json, write_text

    if draws < 20:
        raise InputError.value("--draws", draws, "20 or more")
    start = time.monotonic()
    print("sampling the uncertainties (about 30 s) ...", file=sys.stderr, flush=True)
    with staged(out) as stage:
        balance = analyse_folder(folder, seed, draws)
        sources = [input_file(folder / name) for name in ("lampreydata.csv", "fishwidth.csv")]
        content = animal_record(balance, time.monotonic() - start, sources)
        write_json(stage / "report.json", content)
        write_text(stage / "report.html", animal_page(balance, content))
    print(balance_table(balance))
    print(content["said"])
    print(f"report.html and report.json are in {out}", file=sys.stderr)
