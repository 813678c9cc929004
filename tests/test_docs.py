"""The documentation site covers every command, file key and public module, and has no dead link."""

import re
import shlex
from pathlib import PurePosixPath

import pytest

from docs.generate import api, command_line, effects, file_formats, gallery, performance, tutorials
from slider_jax.cli.commands import COMMANDS, function_of
from slider_jax.cli.main import find
from slider_jax.cli.parse import call_of
from slider_jax.effects.library import LIBRARY
from slider_jax.errors import InputError, did_you_mean
from tests.support.data import ROOT

GENERATED = {
    path: text
    for generator in (api, command_line, effects, file_formats)
    for path, text in generator.pages().items()
}
WRITTEN = {
    path.relative_to(ROOT / "docs").as_posix(): path.read_text(encoding="utf-8")
    for path in sorted((ROOT / "docs").rglob("*.md"))
}
LINK = re.compile(r"\]\(([^)#\s]*)(?:#([^)\s]*))?\)")


def prose(text):
    """A page without its code blocks."""
    return re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)


def anchors(text):
    """Anchors of a page: of its headings, as mkdocs makes them, and those written as HTML."""
    headings = re.findall(r"^#+ (.*)$", prose(text), re.MULTILINE)
    plain = [re.sub(r"[^\w\s-]", "", x.replace("`", "")).strip().lower() for x in headings]
    written = set(re.findall(r'<a id="([^"]+)"', text))
    return written | {re.sub(r"[-\s]+", "-", x) for x in plain}


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_is_on_the_site_with_every_option(name):
    page = GENERATED[command_line.PAGE]
    section = page.split(f"\n## slider {name}\n")[1].split("\n## ")[0]
    with pytest.raises(InputError) as refused:
        call_of(function_of(COMMANDS[name].target), ["--no-such-option"], name)
    options = re.search(r"allowed (--[^;]*)", str(refused.value))[1].split(", ")
    missing = [option for option in options if option not in section]
    assert not missing


def test_every_key_of_the_files_has_a_description():
    texts = file_formats.descriptions()
    schemas = {
        table.__name__: set(table.model_fields)
        for schema, _ in file_formats.FILES.values()
        for table in file_formats.tables(schema).values()
    }
    assert {name: set(keys) for name, keys in texts.items()} == schemas
    page = GENERATED[file_formats.PAGE]
    for keys in texts.values():
        for key, text in keys.items():
            assert text.endswith(".") and any(
                f"| `{key}` |" in line and text in line for line in page.splitlines()
            ), key


def test_units_and_defaults_are_those_of_the_schema():
    page = GENERATED[file_formats.PAGE]
    for line in (
        "| `EI_body` | number | 0.0001 to 100 N m^2 | required | Bending stiffness of the body. |",
        "| `step` | number | 1e-05 to 0.02 s | `0.001` |",
        "| `front_chamber` | array of 2 numbers | 0 to 3 m | none |",
        "| `markers` | integer | 2 to 50 | required |",
        "| `ring_down` | array of tables | at most 1 | none |",
    ):
        assert line in page, line


def test_every_public_module_and_every_effect_is_on_the_site():
    page = "\n".join(GENERATED.values())
    for package in api.PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            if not path.stem.startswith("_"):
                assert f"::: {name}\n" in page, name
    for name, kind in LIBRARY.items():
        section = GENERATED[effects.PAGE].split(f"\n### `{name}`\n")[1].split("\n### ")[0]
        assert kind.title in section
        assert all(f"| `{parameter}` |" in section for parameter in kind.priors() | kind.shapes())


def test_every_page_is_in_the_navigation():
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    for path in {**WRITTEN, **GENERATED}:
        assert path in text or path.startswith(api.FOLDER), path


def test_no_link_of_the_site_is_dead():
    pages = WRITTEN | GENERATED
    for path, text in pages.items():
        for target, anchor in LINK.findall(prose(text)):
            if "://" in target:
                continue
            parts = []
            for part in (PurePosixPath(path).parent / target).parts if target else ():
                parts = parts[:-1] if part == ".." else [*parts, part]
            name = "/".join(parts) or path
            assert name in pages or (ROOT / "docs" / name).is_file(), f"{path}: {target}"
            if anchor and name in pages:
                known = anchors(pages[name])
                assert anchor in known, f"{path}: #{anchor}{did_you_mean(anchor, known)}"


def test_the_gallery_shows_every_command_and_its_commands_are_valid():
    assert set(gallery.ENTRIES) == set(COMMANDS)
    page = WRITTEN["gallery.md"]
    assert page == gallery.render(gallery.kept_outputs()), "run docs/generate/gallery.py"
    for name, entry in gallery.ENTRIES.items():
        assert name in gallery.kept_outputs() or entry.more, name
        assert name == find(shlex.split(entry.line))[0]
        call_of(function_of(COMMANDS[name].target), find(shlex.split(entry.line))[1], name)


def test_the_tutorials_are_those_of_the_notebooks():
    assert tutorials.outdated() == [], "run python docs/generate/tutorials.py"


def test_the_page_on_performance_is_that_of_the_records():
    found = performance.records()
    page = WRITTEN["reference/performance.md"]
    assert page == performance.render(found), "run python docs/generate/performance.py"
    for record in found.values():
        assert record["commit"] and record["date"] and record["machine"]["processor"]
        assert f"at commit {record['commit']} ({record['date']})" in " ".join(page.split())
    found["speed"]["figures"]["times_faster"]["sheet"] = 1234.5
    assert "| 1234 |" in performance.render(found)


def test_a_record_without_its_commit_on_the_page_is_refused(monkeypatch, tmp_path):
    text = (ROOT / "docs" / "generate" / performance.TEMPLATE).read_text()
    (tmp_path / "page.j2").write_text(text.replace('{{ origin("sharing") }}', ""))
    monkeypatch.setattr(performance, "TEMPLATE", tmp_path / "page.j2")
    with pytest.raises(AssertionError, match="without their commit on the page: {'sharing'}"):
        performance.render(performance.records())


def test_pictures_are_small():
    for path in (ROOT / "docs" / "img").rglob("*.png"):
        assert path.stat().st_size < (100_000 if path.parent.name != "img" else 200_000), path
