"""Generates the page of the file formats: the keys of the TOML files, and the CSV columns."""

import tomllib
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from annotated_types import Ge, Le, MaxLen, MinLen
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from calibration.bench.tables import StaticsTable
from rig.cli.settings import RigTable
from slider_jax.channels import SLIDER_CHANNELS, TIME
from slider_jax.experiment.schema import ExperimentTable
from slider_jax.io.toml import quantity_of, tables_in
from slider_jax.io.units import Quantity
from slider_jax.statics.tables import StaticCaseTable

PAGE = "reference/file_formats.md"
KEYS = Path(__file__).with_name("file_keys.toml")
FILES: dict[str, tuple[type[BaseModel], str]] = {
    "Experiment file": (
        ExperimentTable,
        "An experiment file describes a robot and its trials. Most commands read this file. "
        "[experiment.toml](../experiment.toml) is a complete example.",
    ),
    "Bench file": (
        StaticsTable,
        "A bench file describes bench measurements in air, for `slider calibrate statics`. "
        "[bench.toml](../bench.toml) is a complete example.",
    ),
    "Rod file": (
        StaticCaseTable,
        "A rod file describes a rod and its static loads in space, for `slider statics`. "
        "`examples/strip/rod.toml` is a complete example.",
    ),
    "Rig file": (
        RigTable,
        "A rig file describes the hardware of the lab, for `slider rig`. [The "
        "rig](../how-to/rig.md#the-rig-file) has a complete example.",
    ),
}
"""Heading, schema and purpose of each TOML file."""


def descriptions() -> dict[str, dict[str, str]]:
    """Returns the description of each key, by the name of the schema's class and the key."""
    return tomllib.loads(KEYS.read_text(encoding="utf-8"))


def tables(table: type[BaseModel], path: str = "", header: str = "") -> dict[str, type[BaseModel]]:
    """Returns the tables of a file by their heading; the top level's heading is empty.

    The heading is the table's TOML header. If a key allows several tables, the heading of a further
    table also contains the key that only this table has.
    """
    found = {header: table}
    for key, field in table.model_fields.items():
        name = f"{path}.{key}" if path else key
        inner = f"`[[{name}]]`" if _is_list(field) else f"`[{name}]`"
        first, *further = tables_in(field) or [None]
        if first is not None:
            found |= tables(first, name, inner)
        for other in further:
            own = next(x for x in other.model_fields if x not in first.model_fields)
            found |= tables(other, name, f"{inner} with `{own}`")
    return found


def _is_list(field: FieldInfo) -> bool:
    return get_origin(field.annotation) is tuple


def _kind(annotation: Any) -> str:
    """Returns the type of a value in the terms of TOML."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return "table"
    origin, inner = get_origin(annotation), get_args(annotation)
    if {_kind(get_args(x)[0]) for x in inner if hasattr(x, "__metadata__")} == {"table"}:
        return "table"
    if origin is Literal:
        return ", ".join(f"`{x}`" for x in inner)
    if origin is tuple:
        items = [_kind(x) for x in inner if x is not Ellipsis]
        size = "" if Ellipsis in inner else f"{len(items)} "
        return f"array of {size}{items[0]}s"
    if inner and hasattr(annotation, "__metadata__"):
        return _kind(inner[0])
    if inner:
        return " or ".join(dict.fromkeys(_kind(x) for x in inner if x is not type(None)))
    return {float: "number", int: "integer", str: "string", bool: "boolean"}.get(annotation, "any")


def _allowed(field: FieldInfo) -> str:
    """Returns the range and unit of a key."""
    quantity = quantity_of(field) or _quantity_in(field.annotation)
    if quantity is not None:
        return quantity.allowed
    low = [x.ge for x in field.metadata if isinstance(x, Ge)]
    high = [x.le for x in field.metadata if isinstance(x, Le)]
    if low and high:
        return f"{low[0]} to {high[0]}"
    least = [x.min_length for x in field.metadata if isinstance(x, MinLen)]
    most = [x.max_length for x in field.metadata if isinstance(x, MaxLen)]
    limits = [f"at least {x}" for x in least] + [f"at most {x}" for x in most]
    return ", ".join(limits)


def _quantity_in(annotation: Any) -> Quantity | None:
    """Returns the unit and range of the numbers in an annotation, such as that of an array."""
    found = [x for x in getattr(annotation, "__metadata__", ()) if isinstance(x, Quantity)]
    found += [x for x in map(_quantity_in, get_args(annotation)) if x is not None]
    return found[0] if found else None


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.default
    if isinstance(value, BaseModel) or value in (None, ()):
        return "none" if value in (None, ()) else "all defaults"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, tuple):
        return f"`[{', '.join(f'{x:g}' for x in value)}]`"
    return f"`{value:g}`" if isinstance(value, float) else f"`{value}`"


def _rows(table: type[BaseModel], texts: dict[str, str]) -> list[str]:
    lines = ["| key | type | range and unit | default | description |", "|---|---|---|---|---|"]
    for key, field in table.model_fields.items():
        cells = (f"`{key}`", _kind(field.annotation), _allowed(field), _default(field), texts[key])
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def _csv() -> list[str]:
    lines = [
        "## Measured trial",
        "",
        "The trial's key `file` names this CSV file in the experiment file's folder. The first",
        "line has the column names, and each further line has one sample. Only time is required.",
        "A blank cell is a missing sample. `slider simulate` writes files of this format too.",
        "",
        "| column | unit | content |",
        "|---|---|---|",
        f"| `{TIME}` | s | time since the start of the drive; the robot starts from rest |",
    ]
    lines += [f"| `{x.column}` | {x.unit} | {x.label} |" for x in SLIDER_CHANNELS.values()]
    return [
        *lines,
        "",
        "A pressure is the difference between the two sides of a chamber, with the sign of the set",
        "pressure. Thrust is the axial force of the robot on its clamp, positive towards the head.",
        "Recoil is the lateral force of the robot on its clamp, positive to the robot's left. The",
        "displacement of the tip is measured from the straight robot, positive to the left. These",
        "are the columns of a robot with front and rear chamber. The tables `[[actuators]]` and",
        "`[[sensors.channels]]` define the columns of other robots and sensors.",
        "",
        "## Played drive",
        "",
        "`NAME.played.csv` beside `NAME.csv` records the set pressures that the valves followed.",
        "`slider rig run` writes this file. If it exists, it replaces the waveform of the trial.",
        "",
        "| column | unit | content |",
        "|---|---|---|",
        "| `t_s` | s | time from which this row applies; the last row is the end of the trial |",
        "| `set_front_Pa` | Pa | set pressure of the front chamber |",
        "| `set_rear_Pa` | Pa | set pressure of the rear chamber |",
        "",
        "A robot with `[[actuators]]` has the column `set_NAME_Pa` for each chamber.",
        "",
        "## Recorded drive",
        "",
        "The trial's key `drive_file` names this CSV file. It has the columns `t_s`, `p_front_Pa`",
        "and `p_rear_Pa`, with evenly spaced samples that cover the whole trial. A robot with",
        "`[[actuators]]` has the columns `p_NAME_Pa` of its chambers, and those of its tendons and",
        "measured moments.",
    ]


def pages() -> dict[str, str]:
    """Returns the page of the file formats, by path."""
    texts, shown = descriptions(), set()
    lines = [
        "# File formats",
        "",
        "All files use SI units. If a number is outside its range, a key is unknown or a file is",
        "damaged, the command stops. It prints the file, the key and the allowed values. The",
        "ranges detect many wrong units, for example millimetres or kilopascals.",
    ]
    for heading, (schema, purpose) in FILES.items():
        lines += ["", f"## {heading}", "", purpose]
        for name, table in tables(schema).items():
            lines += ["", f"### {name or 'Top level'}", ""]
            if table in shown:
                lines.append(f"The keys of {name} are those of {name} in an experiment file.")
            else:
                lines += _rows(table, texts[table.__name__])
            shown.add(table)
    lines += [
        "",
        "## Model file",
        "",
        "A model file is a TOML file for the option `--model`. It overrides the experiment file.",
        "The calibration commands write model files. A model file may contain `name`, keys of",
        "`[robot]` and `[parameters]`, and `[[effects]]` tables, whose effects are added to the",
        "experiment's. `C_d` and `m_a` in a model file replace `force_coefficients` or vice versa.",
        "",
        *_csv(),
    ]
    return {PAGE: "\n".join([*lines, ""])}
