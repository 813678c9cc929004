"""`slider statics`: computes the shape of a rod at rest under loads, in three dimensions."""

import sys
from pathlib import Path
from typing import Annotated

import tyro

from slider_jax.cli.options import Folder


def rod_statics(
    input: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="ROD.toml")], out: Folder
) -> None:
    """Computes the shape of a rod at rest under loads, and whether this shape is stable.

    A clamp or a hinge holds one end of the rod; a second support may hold the other end. Forces,
    moments, weight, tendons and pressure chambers act on the rod. DIR receives statics.json with
    the position and frame of the tip, the loads on the supports and the stability; shape.csv with
    the shape; and shape.png with a picture.

    Args:
        input: file that describes the rod and its loads.
        out: folder for the results; created if missing. Existing files are replaced.
    """
    from slider_jax.cli.options import refuse_own_folder
    from slider_jax.io.files import staged
    from slider_jax.rod.equilibrium import NEUTRAL, smallest_eigenvalue, solve_equilibrium
    from slider_jax.statics.case import load_case
    from slider_jax.statics.report import write_statics

    case = load_case(input)
    refuse_own_folder(out, input.parent)
    with staged(out) as stage:
        found = solve_equilibrium(case.rod, case.loads, case.end)
        eigenvalue = smallest_eigenvalue(found, case.rod, case.loads, case.end)
        write_statics(case, found, eigenvalue, stage)
    tip = ", ".join(f"{x:.6g}" for x in found.shape.position[-1].tolist())
    moment = ", ".join(f"{x:.6g}" for x in found.moment.tolist())
    print(f"tip at ({tip}) m; moment on the support ({moment}) N m")
    state = "stable" if eigenvalue > NEUTRAL else "unstable"
    state = "neutral" if abs(eigenvalue) <= NEUTRAL else state
    compared = " (1 without loads)" if case.table.rod.start == "clamped" else ""
    print(f"{state}: smallest eigenvalue {eigenvalue:.4g}{compared}")
    if state == "unstable":
        print(
            "a real rod leaves this shape: a larger load to the side, or an initial curvature, "
            "leads to the bent shape",
            file=sys.stderr,
        )
    print(f"statics.json, shape.csv and shape.png are in {out}", file=sys.stderr)
