"""Writes the tutorials: the notebooks with their output and pictures, as pages in docs/tutorials/.

    python docs/generate/tutorials.py [NAME ...]    # runs the notebooks whose code changed
    python docs/generate/tutorials.py --check       # lists the pages that are out of date
    python docs/generate/tutorials.py --keep-output # keeps the output although the code changed

A page keeps a hash of its notebook's code. If only the text of a notebook changed, the page gets
the new text and keeps its output.
"""

import argparse
import hashlib
import io
import os
import re
import sys
import tempfile
from contextlib import chdir, redirect_stdout
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
PAGES, PICTURES = ROOT / "docs" / "tutorials", ROOT / "docs" / "img" / "tutorials"
LARGEST_PICTURE = 100_000
"""Largest size of a picture file in bytes, so that the repository stays small."""
DPI = 80


class Cell(NamedTuple):
    """A cell of a notebook: Markdown text or Python code."""

    is_code: bool
    text: str


def notebooks() -> list[Path]:
    """Returns the notebooks, in percent format."""
    return sorted((ROOT / "notebooks").glob("*.py"))


def cells(notebook: Path) -> list[Cell]:
    """Returns the cells of a notebook."""
    found = []
    for part in re.split(r"^# %%", notebook.read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]:
        kind, _, text = part.partition("\n")
        is_code = "[markdown]" not in kind
        if not is_code:
            text = re.sub(r"^# ?", "", text, flags=re.MULTILINE)
        found.append(Cell(is_code, text.strip()))
    return found


def code_hash(notebook: Path) -> str:
    """Returns a hash of a notebook's code."""
    code = "\n".join(cell.text for cell in cells(notebook) if cell.is_code)
    return hashlib.sha256(code.encode()).hexdigest()[:16]


def page_of(notebook: Path) -> Path:
    """Returns the path of a notebook's page."""
    return PAGES / f"{notebook.stem}.md"


def _stamp(notebook: Path) -> str:
    return f"<!-- Made by docs/generate/tutorials.py from code {code_hash(notebook)}. -->"


def kept_outputs(notebook: Path, any_code: bool = False) -> dict[int, str] | None:
    """Returns the outputs in a notebook's page, by the number of the cell.

    Returns None if the page does not exist. Without `any_code`, also returns None if the notebook's
    code has changed since the outputs were written.
    """
    path = page_of(notebook)
    page = path.read_text(encoding="utf-8") if path.exists() else ""
    if not page or not (any_code or page.startswith(_stamp(notebook))):
        return None
    outputs = re.findall(r"<!-- output (\d+) -->\n(.*?)\n<!-- end -->", page, re.DOTALL)
    return {int(number): text for number, text in outputs}


def render(notebook: Path, outputs: dict[int, str]) -> str:
    """Returns a notebook's page, given the outputs of its code cells."""
    parts = [_stamp(notebook)]
    for number, cell in enumerate(cells(notebook)):
        parts.append(f"```python\n{cell.text}\n```" if cell.is_code else cell.text)
        if number in outputs:
            parts.append(f"<!-- output {number} -->\n{outputs[number]}\n<!-- end -->")
    source = f"notebooks/{notebook.name}"
    parts.append(f"This page is `{source}`. `python {source}` runs it.")
    return "\n\n".join(parts) + "\n"


def outdated() -> list[str]:
    """Returns the names of the notebooks whose page is missing or differs from the notebook."""
    found = []
    for notebook in notebooks():
        outputs = kept_outputs(notebook)
        if outputs is None or page_of(notebook).read_text(encoding="utf-8") != render(
            notebook, outputs
        ):
            found.append(notebook.stem)
    return found


def execute(notebook: Path) -> dict[int, str]:
    """Runs a notebook, writes its pictures, and returns the outputs by cell."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    pictures: list[Path] = []
    heading = ""

    def show() -> None:
        for number in plt.get_fignums():
            path = PICTURES / f"{notebook.stem}_{len(pictures) + 1}.png"
            plt.figure(number).savefig(path, dpi=DPI, pil_kwargs={"optimize": True})
            if path.stat().st_size > LARGEST_PICTURE:
                raise SystemExit(f"{path}: over {LARGEST_PICTURE} bytes; draw a simpler picture")
            pictures.append(path)
        plt.close("all")

    plt.show = show
    names: dict[str, object] = {"__name__": "__main__", "__file__": str(notebook)}
    outputs = {}
    PICTURES.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        os.environ["SLIDER_DATA"] = str(Path(folder) / "none")
        for number, cell in enumerate(cells(notebook)):
            if not cell.is_code:
                heading = next(iter(re.findall(r"^#+ (.*)$", cell.text, re.MULTILINE)), heading)
                continue
            text, before = io.StringIO(), len(pictures)
            with redirect_stdout(text):
                exec(compile(cell.text, f"{notebook.name}, cell {number}", "exec"), names)
            lines = text.getvalue().replace(f"{folder}/", "").strip().splitlines()
            printed = "\n".join(line.rstrip() for line in lines)
            parts = [f"```text\n{printed}\n```"] if printed else []
            new = pictures[before:]
            parts += [f"![{heading}](../img/tutorials/{path.name})" for path in new]
            if parts:
                outputs[number] = "\n\n".join(parts)
    return outputs


def main() -> int:
    """Runs the script; returns 1 if `--check` finds a page that is out of date, or else 0."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help="notebooks to run (default: those that changed)")
    parser.add_argument("--check", action="store_true", help="only list outdated pages")
    parser.add_argument(
        "--keep-output", action="store_true", help="keep the output although the code changed"
    )
    asked = parser.parse_args()
    if asked.check:
        names = outdated()
        for name in names:
            print(f"docs/tutorials/{name}.md: out of date; run python docs/generate/tutorials.py")
        return bool(names)
    PAGES.mkdir(exist_ok=True)
    for notebook in notebooks():
        if asked.names and notebook.stem not in asked.names:
            continue
        kept = kept_outputs(notebook, asked.keep_output)
        if kept is None or (asked.names and not asked.keep_output):
            print(f"running {notebook.stem}", file=sys.stderr)
            kept = execute(notebook)
        page_of(notebook).write_text(render(notebook, kept), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
