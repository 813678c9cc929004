"""Writes the tables and the picture of the page on the paper's statements.

slider published --all --out results/published
python docs/generate/statements.py results/published
"""

import argparse
import json
import re
from pathlib import Path

from PIL import Image

from slider_jax.statements.statements import SIMULATED

DOCS = Path(__file__).resolve().parents[1]
PAGE, PICTURE = DOCS / "explanation" / "the_papers_statements.md", DOCS / "img" / "statements.png"
WIDTH = 900
"""Width of the picture [pixels]."""


def number(x: float | None, digits: int = 3) -> str:
    return "–" if x is None else f"{x:.{digits}g}"


def table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def tables_of(record: dict) -> dict[str, str]:
    """Returns the tables by name."""
    simulated, printed, other = [], [], []
    for x in record["statements"]:
        allowed = f"{x['allowed']} {x['unit']}".removesuffix(" -")
        if x["kind"] in ("simulated", "map", "optimum"):
            reading = SIMULATED[x["name"]].reading if x["name"] in SIMULATED else ""
            text = f"{x['text']} ({reading})" if reading else x["text"]
            row = [x["place"], text, allowed, number(x["built_in"]), number(x["fitted"])]
            simulated.append([*row, x["verdict"]])
        elif x["kind"] == "printed":
            printed.append(
                [x["place"], x["text"], number(x["built_in"], 4), x["why"], x["verdict"]]
            )
        elif x["verdict"] == "not decidable":
            other.append([x["place"], x["text"], x["why"]])
    built_in, joint = record["settings"]["assumptions"].values()
    assumptions = [
        [f"`{name}`", number(built_in[name]), number(joint[name]),
         f"{x['low']:.3g} to {x['high']:.3g}", x["unit"], x["reason"]]
        for name, x in record["ranges"].items()
    ]  # fmt: skip
    gaits = [
        [name, f"{x['gait']['frequency']:.2f}", f"{1e-3 * x['gait']['front']:.0f}",
         f"{1e-3 * x['gait']['rear']:.0f}", f"{x['gait']['phase']:.2f}",
         f"{1e3 * x['gait']['tail_length']:.0f}", f"{1e3 * x['gait']['EI_tail']:.1f}",
         f"{100 * x['speed_m_per_s']:.1f}"]
        for name, x in record["optimum"].items()
    ]  # fmt: skip
    waves = record["wavelengths_m"]
    kinds = next(iter(waves.values()))
    return {
        "simulated": table(
            ["place", "statement", "allowed", "built-in", "joint", "verdict"], simulated
        ),
        "printed": table(["place", "statement", "calculated", "calculation", "verdict"], printed),
        "undecidable": table(["place", "statement", "reason"], other),
        "assumptions": table(
            ["assumption", "built-in", "joint", "range", "unit", "reason"], assumptions
        ),
        "optimum": table(
            ["", "f (Hz)", "front (kPa)", "rear (kPa)", "phase", "tail (mm)", "EI (mN m²)", "cm/s"],
            gaits,
        ),
        "waves": table(
            ["definition", *waves],
            [[kind, *(number(1e3 * x[kind]) for x in waves.values())] for kind in kinds],
        ),
        "searches": table(
            ["statements that count", "start", "agree", "peak (mN)", "at (Hz)", "A_t (mm)", "cm/s"],
            [[x["objective"], str(x["start"]), str(len(x["agree"])), *of_front(x)]
             for x in record["searches"]],
        ),
        "front": table(
            ["peak (mN)", "at (Hz)", "A_t (mm)", "cm/s"], [of_front(x) for x in record["front"]]
        ),
    }  # fmt: skip


def of_front(x: dict) -> list[str]:
    found = x["facts"]
    return [
        f"{1e3 * found['sweep_peak_N']:.0f}",
        f"{found['sweep_peak_Hz']:.1f}",
        f"{1e3 * found['tail_amplitude_m']:.1f}",
        f"{100 * found['speed_m_per_s']:.1f}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="results of `slider published --all`")
    folder = parser.parse_args().folder
    record = json.loads((folder / "published.json").read_text(encoding="utf-8"))
    page = PAGE.read_text(encoding="utf-8")
    for name, text in tables_of(record).items():
        pattern = rf"(<!-- table {name} -->\n).*?(<!-- end -->)"
        page, found = re.subn(pattern, lambda m, t=text: f"{m[1]}{t}\n{m[2]}", page, flags=re.S)
        if found != 1:
            raise SystemExit(f"{PAGE}: {found} places for the table {name}; allowed is one")
    PAGE.write_text(page, encoding="utf-8")
    picture = Image.open(folder / "fig4.png").convert("RGB")
    height = round(picture.height * WIDTH / picture.width)
    picture.resize((WIDTH, height)).quantize(64).save(PICTURE, optimize=True)
    print(record["said"])


if __name__ == "__main__":
    main()
