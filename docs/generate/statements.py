"""Writes the tables and the pictures of the pages on the paper's statements and designs.

slider published --all --out results/published
python docs/generate/statements.py results/published
"""

import argparse
import json
import re
from pathlib import Path

from PIL import Image

from calibration.reporting.statements import TextTable, statement_tables

DOCS = Path(__file__).resolve().parents[1]
PAGE = DOCS / "explanation" / "the_papers_statements.md"
PICTURES = {"fig4.png": "statements.png", "fig7_built-in_robot.png": "design_maps.png"}
"""Figures of the results, and their names in docs/img."""
WIDTH = 900
"""Width of a picture [pixels]."""
COLUMNS = {"simulated": 6, "front": 4}
"""Number of columns that the page shows, for tables with more columns."""
NOT_SHOWN = ("tolerances", "others")


def markdown(table: TextTable, columns: int | None) -> str:
    """Returns the first `columns` columns of a table as Markdown."""
    lines = [x[:columns] for x in (table.head, ["---"] * len(table.head), *table.rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="results of `slider published --all`")
    folder = parser.parse_args().folder
    record = json.loads((folder / "published.json").read_text(encoding="utf-8"))
    page = PAGE.read_text(encoding="utf-8")
    for name, table in statement_tables(record).items():
        if name in NOT_SHOWN:
            continue
        text = markdown(table, COLUMNS.get(name))
        pattern = rf"(<!-- table {name} -->\n).*?(<!-- end -->)"
        page, found = re.subn(pattern, lambda m, t=text: f"{m[1]}{t}\n{m[2]}", page, flags=re.S)
        if found != 1:
            raise SystemExit(f"{PAGE}: {found} places for the table {name}; allowed is one")
    PAGE.write_text(page, encoding="utf-8")
    for source, name in PICTURES.items():
        picture = Image.open(folder / source).convert("RGB")
        height = round(picture.height * WIDTH / picture.width)
        picture.resize((WIDTH, height)).quantize(64).save(DOCS / "img" / name, optimize=True)
    print(record["said"])


if __name__ == "__main__":
    main()
