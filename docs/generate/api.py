"""Generates the API reference from the docstrings: one page for each folder of the packages."""

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("slider_jax", "calibration", "rig")
FOLDER = "reference/api"


def modules() -> dict[str, list[str]]:
    """Returns a dictionary from the dotted name of each folder to the folder's public modules."""
    found: dict[str, list[str]] = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            folder = ".".join(path.parent.relative_to(ROOT).parts)
            found.setdefault(folder, [])
            if not path.stem.startswith("_"):
                found[folder].append(f"{folder}.{path.stem}")
    return found


def public_names(module: str) -> list[str]:
    """Returns the dotted names of the public functions and classes that a module defines."""
    tree = ast.parse((ROOT / (module.replace(".", "/") + ".py")).read_text())
    kinds = (ast.FunctionDef, ast.ClassDef)
    names = [x.name for x in tree.body if isinstance(x, kinds) and not x.name.startswith("_")]
    return [f"{module}.{name}" for name in names]


def page_name(folder: str) -> str:
    """Returns the path of a folder's page in the site's sources."""
    return f"{FOLDER}/{folder}.md"


def _page(folder: str, members: list[str]) -> str:
    lines = [f"# {folder}", "", f"::: {folder}"]
    lines += ["    options:", "      members: false", "      show_root_heading: false"]
    for module in members:
        lines += ["", f"::: {module}"]
    return "\n".join([*lines, ""])


def pages() -> dict[str, str]:
    """Returns a dictionary from the path of each page of the API reference to its text."""
    return {page_name(folder): _page(folder, members) for folder, members in modules().items()}


def navigation() -> list[dict[str, list[dict[str, str]]]]:
    """Returns the entries of the site's navigation: a list of pages for each package."""
    folders = list(modules())
    return [
        {package: [{x: page_name(x)} for x in folders if x.split(".")[0] == package]}
        for package in PACKAGES
    ]
