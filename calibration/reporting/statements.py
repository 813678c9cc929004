"""Writes the tables of the paper's statements, for a page and for the terminal."""

from typing import Any, NamedTuple

from calibration.reporting.html import render_page
from slider_jax.optimise.design_space import VARIABLES
from slider_jax.statements.statements import INCONSISTENT, SIMULATED, UNDECIDABLE
from slider_jax.statements.verdicts import CHECKED

FACTS = {
    "peak (mN)": ("sweep_peak_N", 1e3, ".0f"),
    "at (Hz)": ("sweep_peak_Hz", 1.0, ".1f"),
    "A_t (mm)": ("tail_amplitude_m", 1e3, ".1f"),
    "cm/s": ("speed_m_per_s", 100.0, ".1f"),
}
"""Main facts of a set of assumptions: name, factor from SI units, and format of each column."""


class TextTable(NamedTuple):
    """A table of text."""

    title: str
    note: str
    head: list[str]
    rows: list[list[str]]


def statement_tables(record: dict[str, Any]) -> dict[str, TextTable]:
    """Returns the tables of published.json, by name; `record` is the content of the file."""
    built_in, joint = record["settings"]["assumptions"].values()
    waves, refined = record["wavelengths_m"], record["refined"]
    changeable = [name for name in record["ranges"] if name not in ("EA", "damping_time")]
    return _of_statements(record["statements"]) | {
        "tolerances": TextTable(
            "Tolerances", "", ["statement", "tolerance"],
            [list(x) for x in record["tolerances"].items()],
        ),
        "assumptions": TextTable(
            "Assumptions", "",
            ["assumption", "built-in", "joint", "range", "unit", "reason"],
            [[name, number(built_in[name]), number(joint[name]),
              f"{x['low']:.3g} to {x['high']:.3g}", x["unit"], x["reason"]]
             for name, x in record["ranges"].items()],
        ),
        "changes": TextTable(
            "Single changes of the built-in robot",
            "Each row moves one assumption to an end of its range.",
            ["assumption", "value", *FACTS],
            [["no change", "", *_facts(record["facts"]["built-in robot"])]]
            + [[x["assumption"], number(x["value"]), *_facts(x["facts"])]
               for x in record["single_changes"]],
        ),
        "optimum": TextTable(
            "Optimum of the genetic algorithm", "",
            ["", *(f"{k} ({v.unit})" for k, v in VARIABLES.items()), "cm/s"],
            [[name, *(number(v.factor * x["gait"][k]) for k, v in VARIABLES.items()),
              f"{100 * x['speed_m_per_s']:.1f}"]
             for name, x in record["optimum"].items()],
        ),
        "head_drag": TextTable(
            "Drag area of the head",
            "The paper measured 21.7 cm/s with a tail of 70 mm. The built-in robot uses the first "
            "area, which was calibrated with a tail of 53 mm.",
            ["drag area (cm²)", "cm/s with a tail of 53 mm", "cm/s with a tail of 70 mm"],
            [[f"{1e4 * x['area_m2']:.1f}",
              *(f"{100 * x[f'speed_{mm}_mm_m_per_s']:.1f}" for mm in (53, 70))]
             for x in record["head_drag"]],
        ),
        "waves": TextTable(
            "Wavelength at the paper's optimum (mm)",
            "The paper states 280 mm (model) and 265 mm (experiment) without a definition. A "
            "negative value is a wave towards the head.",
            ["definition", *waves],
            [[kind, *(number(x[kind], 3, 1e3) for x in waves.values())]
             for kind in next(iter(waves.values()))],
        ),
        "searches": TextTable(
            f"Searches on a coarse mesh ({record['evaluated']} sets)", "",
            ["statements that count", "start", "agree", *FACTS],
            [[x["objective"], str(x["start"]), str(len(x["agree"])), *_facts(x["facts"])]
             for x in record["searches"]],
        ),
        "gradients": TextTable(
            "Gradient steps from the best set, on the mesh of the other tables", "",
            ["start", "steps", "score before", "score", "agree before", "agree", *FACTS],
            [[str(refined["start"]), str(refined["steps"]), f"{refined['score_before']:.3f}",
              f"{refined['score']:.3f}", str(len(refined["agree_before"])),
              str(len(refined["agree"])), *_facts(refined["facts"])]],
        ),
        "front": TextTable(
            "Head-fixed thrust against tail amplitude",
            "No simulated set of assumptions is nearer to the paper in both quantities than a set "
            "in this table.",
            [*FACTS, *changeable],
            [[*_facts(x["facts"]), *(number(x["assumptions"][name]) for name in changeable)]
             for x in record["front"]],
        ),
    }  # fmt: skip


def _of_statements(statements: list[dict[str, Any]]) -> dict[str, TextTable]:
    checked, printed, undecidable, others = [], [], [], []
    for x in statements:
        if x["kind"] in CHECKED:
            reading = SIMULATED[x["name"]].reading if x["name"] in SIMULATED else ""
            text = f"{x['text']} ({reading})" if reading else x["text"]
            allowed = f"{x['allowed']} {x['unit']}".removesuffix(" -").rstrip()
            remarks = x["why"].removeprefix(reading).removeprefix("; ")
            checked.append([x["place"], text, allowed, number(x["built_in"]), number(x["fitted"]),
                            x["verdict"], remarks])  # fmt: skip
        elif x["kind"] == "printed" or x["verdict"] == INCONSISTENT:
            printed.append([x["place"], x["text"], number(x["built_in"], 4), x["why"],
                            x["verdict"]])  # fmt: skip
        elif x["verdict"] == UNDECIDABLE:
            undecidable.append([x["place"], x["text"], x["why"]])
        else:
            others.append([x["place"], x["text"], x["verdict"], x["why"]])
    return {
        "simulated": TextTable(
            "Statements that a simulation checks", "A statement agrees only within the allowed "
            "interval, which was set before the search for assumptions.",
            ["place", "statement", "allowed", "built-in", "joint", "verdict", "remarks"], checked,
        ),
        "printed": TextTable(
            "Numbers that follow from other numbers of the paper", "",
            ["place", "statement", "calculated", "calculation", "verdict"], printed,
        ),
        "undecidable": TextTable(
            "Statements that cannot be decided", "", ["place", "statement", "reason"], undecidable
        ),
        "others": TextTable(
            "Inputs, and statements that are not simulated", "",
            ["place", "statement", "verdict", "remarks"], others,
        ),
    }  # fmt: skip


def statements_page(record: dict[str, Any]) -> str:
    """Returns the content of published.html; `record` is the content of published.json."""
    tables = statement_tables(record).values()
    return render_page("statements.html", title="The paper's statements", record=record,
                       tables=tables)  # fmt: skip


def statements_summary(record: dict[str, Any]) -> str:
    """Returns the statements that a simulation checks, as a table for the terminal."""
    lines = [f"{'':34}{'paper':>18} {'unit':6}{'built-in':>10}{'joint':>10}"]
    for x in record["statements"]:
        if x["kind"] in CHECKED and x["kind"] != "map":
            name = x["name"].replace("_", " ")
            lines.append(
                f"{name:34}{x['allowed']:>18} {x['unit']:6}{number(x['built_in'], 4):>10}"
                f"{number(x['fitted'], 4):>10}  {x['verdict']}"
            )
    lines += [""] + [f"{number:4}  {verdict}" for verdict, number in record["counts"].items()]
    return "\n".join(lines)


def number(x: float | None, digits: int = 3, factor: float = 1.0) -> str:
    """Returns a number as text, or a dash for None."""
    return "–" if x is None else f"{factor * x:.{digits}g}"


def _facts(found: dict[str, float | None]) -> list[str]:
    texts = []
    for name, factor, form in FACTS.values():
        value = found[name]
        texts.append("–" if value is None else format(factor * value, form))
    return texts
