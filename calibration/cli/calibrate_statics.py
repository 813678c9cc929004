"""`slider calibrate statics`: identifies EI, damping and K_Q from bench tests in air."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import tyro

from slider_jax.cli.options import Folder, Pictures


def statics(
    bench: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="BENCH.toml")],
    out: Folder,
    plot: Pictures = True,
) -> None:
    """Identifies bending stiffness EI, damping time alpha and K_Q (moment per pressure) in air.

    The bench tests are tip loads, a ring-down and static pressures. The command writes
    DIR/statics.json (values, 95 % intervals and the residuals of every table), DIR/model.toml (for
    `slider simulate --model`) and a picture of every table.

    Args:
        bench: bench file (.toml). Its tables (.csv) must be in the same folder.
        out: folder for the results; created if missing. Files of the same name are replaced.
        plot: draw the pictures (PNG); --no-plot omits them.
    """
    from calibration.bench import report
    from calibration.bench.ring_down import fit_ring_down
    from calibration.bench.statics import fit_shapes
    from calibration.bench.tables import load_bench
    from slider_jax.io.files import input_file, staged, write_json, write_text

    found = load_bench(bench)
    shapes = ring = None
    with staged(out) as stage:
        if found.shapes:
            print("fitting the static shapes ...", file=sys.stderr)
            shapes = fit_shapes(found)
        if found.ring_down is not None:
            print("fitting the ring-down ...", file=sys.stderr)
            known = shapes.parameters if shapes else {}
            EI = {name: x.value for name, x in known.items() if x.determined}
            robot = found.robot.with_tail(EI=EI.get("EI_tail"))
            robot = replace(robot, body=robot.body.changed(EI=EI.get("EI_body")))
            ring = fit_ring_down(found, robot)
        result = report.Statics(found, shapes, ring)
        write_json(stage / "statics.json", report.statics_record(result, input_file(bench)))
        write_text(stage / "model.toml", report.statics_model_file(result))
        if plot:
            report.draw_statics(result, stage)
    print(report.statics_table(result))
    print(f"statics.json, model.toml{' and pictures' if plot else ''} are in {out}")
