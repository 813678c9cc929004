"""mkdocs hook: adds the generated reference pages and checks that the site is complete."""

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from mkdocs.exceptions import PluginError  # noqa: E402
from mkdocs.structure.files import File, Files  # noqa: E402
from mkdocstrings import Inventory  # noqa: E402

from docs.generate import api, command_line, effects, file_formats  # noqa: E402


def on_config(config: Any) -> Any:
    """Appends the API reference to the navigation."""
    config.nav.append({"API": api.navigation()})
    return config


def on_files(files: Files, config: Any) -> Files:
    """Adds the generated pages to the site."""
    for generator in (api, command_line, effects, file_formats):
        for path, text in generator.pages().items():
            files.append(File.generated(config, path, content=text))
    return files


def on_post_build(config: Any) -> None:
    """Stops the build if a public function or class has no entry in the API reference."""
    inventory = Path(config.site_dir) / "objects.inv"
    with inventory.open("rb") as file:
        known = Inventory.parse_sphinx(file)
    names = [
        name for members in api.modules().values() for x in members for name in api.public_names(x)
    ]
    missing = [name for name in names if name not in known]
    if missing:
        raise PluginError(f"these names have no entry in the API reference: {', '.join(missing)}")
