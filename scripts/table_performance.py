"""Compares the paper's table of the optimum with this model, and computes the table's sensitivity.

    python scripts/table_performance.py results/table

The script prints the table, and the tail slope for several definitions of the wavelength. It also
prints these values after single changes of the model. The script writes table.json and table.png,
and takes about five minutes.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

from slider_jax.errors import InputError, SolverError
from slider_jax.io.figures import new_figure, save_figure
from slider_jax.io.files import staged, versions, write_json
from slider_jax.precision import enable_float64
from slider_jax.reproduction.table_sensitivity import (
    CHANGES,
    RECALIBRATED,
    SteadyRow,
    clamped_performance,
    fit_head_drag,
    head_fixed_thrust,
    steady_row,
)
from slider_jax.reproduction.wavelengths import course_coordinates
from slider_jax.swimming.free_swim import free_swimmer, steady_settings
from slider_jax.swimming.paper_optimum import MEASURED_SPEED, PUBLISHED, optimum
from slider_jax.swimming.performance import performance_columns
from slider_jax.swimming.report import swim_table

STATED, OWN = PUBLISHED["tail_slope"].model, PUBLISHED["shape_tail_slope"].model
LENGTHS_PER_S = 0.59
"""Measured speed of the paper's optimum in body lengths per second."""
HEAD_FIXED = 365e3
"""Pressure [Pa] of the head-fixed test: the paper's Q_set divided by the paper's K_Q."""
AGAIN = ", resistance calibrated"


def content_of(row: SteadyRow) -> dict[str, Any]:
    """Returns a row of table.json."""
    found = {name: float(x) for name, x in performance_columns(row.performance).items()}
    return found | {
        "head_drag_area_m2": row.area,
        "rms_tail_slope": row.rms_tail_slope,
        "wavelengths_m": row.wavelengths,
        "tail_slopes": row.slopes(),
    }


def line(name: str, x: dict[str, Any]) -> str:
    """Returns the line of one change of the model."""
    slopes = x["tail_slopes"]
    return (
        f"{name:48}{1e4 * x['head_drag_area_m2']:8.1f}{1e2 * x['speed_m_per_s']:8.1f}"
        f"{1e3 * x['tail_amplitude_m']:7.1f}{x['travelling_index']:8.2f}"
        f"{1e3 * x['shape_wavelength_m']:8.0f}{slopes['shape']:8.3f}{slopes['zeros']:8.3f}"
        f"{slopes['phase']:8.3f}{x['rms_tail_slope']:8.3f}"
    )


def report_lines(content: dict[str, Any]) -> list[str]:
    """Returns the lines of the printed report."""
    swims, held_head = content["swims"], content["head_clamped"]
    here = swims[next(iter(CHANGES))]
    lines = [swim_table(here, PUBLISHED)]
    lengths = content["lengths_per_s"]
    measured = f"{LENGTHS_PER_S:12}{lengths / LENGTHS_PER_S:8.2f}"
    lines += [f"{'lengths per second':34}{lengths:10.4g}{'':22}{measured}", ""]
    lines += [
        f"{'tail slope by definition of wavelength':40}{'mm':>8}{'slope':>8}{'/ ' + str(OWN):>8}"
    ]
    for name, wavelength in here["wavelengths_m"].items():
        slope = here["tail_slopes"][name]
        lines.append(f"{name:40}{1e3 * wavelength:8.4g}{slope:8.3f}{slope / OWN:8.2f}")
    rms = here["rms_tail_slope"]
    lines += [f"{'root mean square slope':40}{'':8}{rms:8.3f}{rms / STATED:8.2f} (/ {STATED})", ""]
    lines.append(
        f"{'':48}{'cm^2':>8}{'cm/s':>8}{'A_t':>7}{'index':>8}{'lambda':>8}"
        f"{'shape':>8}{'zeros':>8}{'phase':>8}{'rms':>8}"
    )
    lines += [line(name, x) for name, x in swims.items()]
    lines.append(
        f"{'head clamped, towed at the same speed':48}{'':16}"
        f"{1e3 * held_head['tail_amplitude_m']:7.1f}{held_head['travelling_index']:8.2f}"
        f"{1e3 * held_head['shape_wavelength_m']:8.0f}{held_head['shape_tail_slope']:8.3f}{'':16}"
        f"{held_head['rms_tail_slope']:8.3f}"
    )
    lines += ["", f"mean thrust, head fixed, 4.8 Hz, {1e-3 * HEAD_FIXED:g} kPa (paper: 60 mN)"]
    lines += [f"{name:48}{1e3 * x:8.1f} mN" for name, x in content["head_fixed_thrust_N"].items()]
    return lines


def plot_tail_slopes(content: dict[str, Any], rows: dict[str, SteadyRow], path: Path) -> None:
    """Plots tail slopes for each change and definition, and the midlines of three models."""
    swims, chosen = content["swims"], [next(iter(CHANGES)), *(n + AGAIN for n in RECALIBRATED[:2])]
    figure, axes = new_figure(1, 2, figsize=(12, 7), width_ratios=(3, 2))
    slopes, shapes = axes
    names = list(swims)
    for mark, label in (("o", "shape"), ("s", "zeros"), ("^", "phase")):
        found = [swims[n]["tail_slopes"][label] for n in names]
        slopes.plot(found, range(len(names)), mark, ms=5, label=f"wavelength by {label}")
    rms = [swims[n]["rms_tail_slope"] for n in names]
    slopes.plot(rms, range(len(names)), "kx", ms=6, label="root mean square slope")
    for value, colour in ((OWN, "C0"), (STATED, "k")):
        slopes.axvline(value, color=colour, lw=1.0, label=f"paper: {value:g}")
    slopes.axvspan(0.85 * OWN, 1.15 * OWN, color="C0", alpha=0.12, label=f"15 % of {OWN:g}")
    slopes.set_yticks(range(len(names)), [n.replace(AGAIN, ",\n" + AGAIN[2:]) for n in names])
    slopes.invert_yaxis()
    slopes.set_xlabel("tail slope")
    slopes.legend(fontsize="small", loc="center right")
    slopes.grid(axis="y", color="0.9")
    for i, name in enumerate(chosen):
        along, across = course_coordinates(rows[name].stride)
        x = along - along.mean(axis=1)[:, None]
        for j in range(0, len(x), max(1, len(x) // 10)):
            shapes.plot(1e3 * x[j], 1e3 * across[j] - 130.0 * i, color=f"C{i}", lw=0.8)
        shapes.text(-190.0, -130.0 * i + 58.0, name, color=f"C{i}", fontsize="small")
    shapes.set_aspect("equal")
    shapes.set_ylim(-310.0, 75.0)
    shapes.set_xlabel("along the course, tail on the left (mm)")
    shapes.set_ylabel("across, each model 130 mm below the previous one (mm)")
    save_figure(figure, path)


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, metavar="OUT_DIR", help="folder for the results")
    given = parser.parse_args(argv)
    enable_float64()
    experiment = optimum()
    frequency, model = free_swimmer(experiment, experiment.trials[0])
    search = steady_settings(experiment, frequency)
    first = next(iter(CHANGES))
    with staged(given.folder) as stage:
        rows = {}
        for name, change in CHANGES.items():
            print(f"{name} ...", file=sys.stderr, flush=True)
            rows[name] = steady_row(change(model), frequency, search)
        for name in RECALIBRATED:
            print(f"{name}{AGAIN} ...", file=sys.stderr, flush=True)
            found = fit_head_drag(CHANGES[name](model), frequency, MEASURED_SPEED, search)
            rows[name + AGAIN] = found
        content = {
            "paper": {name: x._asdict() for name, x in PUBLISHED.items()},
            "swims": {name: content_of(x) for name, x in rows.items()},
            "lengths_per_s": float(rows[first].performance.speed / model.body.length),
            "head_clamped": clamped_performance(model, frequency, MEASURED_SPEED, search),
            "head_fixed_thrust_N": {
                name: head_fixed_thrust(name, HEAD_FIXED, model, search)
                for name in (first, *RECALIBRATED[:2])
            },
            "settings": {
                "experiment": experiment.model_dump(),
                "steps_per_stride": search.steps_per_stride,
                "nodes": search.numerics.nodes,
                "head_fixed_pressure_Pa": HEAD_FIXED,
            },
            "versions": versions(),
        }
        write_json(stage / "table.json", content)
        plot_tail_slopes(content, rows, stage / "table.png")
    print("\n".join(report_lines(content)))
    print(f"wrote table.json and table.png to {given.folder}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (InputError, SolverError) as error:
        print(f"table_performance: {error}", file=sys.stderr)
        sys.exit(2)
