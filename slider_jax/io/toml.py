"""Reads, validates and writes TOML. Errors name the file, the key and the allowed values."""

import difflib
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar, get_args, get_origin

import tomlkit
from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from tomlkit.items import Table

from slider_jax.errors import InputError
from slider_jax.io.units import Quantity

TableType = TypeVar("TableType", bound=BaseModel)


def read_bytes(path: Path) -> bytes:
    """Returns the content of an input file. Raises `InputError` for an unreadable file."""
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give a file in this folder")
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; check the name") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None


def read_toml(path: Path) -> dict[str, Any]:
    """Returns the tables of a TOML file. Raises `InputError` with the line and column."""
    try:
        text = read_bytes(path).decode("utf-8")
        return tomllib.loads(text)
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text (byte {error.start}); save as UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not valid TOML: {error}{_unit_advice(text, error)}") from None


def toml_text(
    content: Mapping[str, Any], comment: str = "", units: Mapping[str, str] = MappingProxyType({})
) -> str:
    """Returns the values, tables and lists of tables in `content` as the text of a TOML file.

    Each line of `comment` becomes a comment line at the top. `units` contains the unit of each key.
    The unit is written as a comment after the key's value.
    """
    document = tomlkit.document()
    for line in comment.splitlines():
        document.add(tomlkit.comment(line))
    for name, value in content.items():
        document.add(name, tomlkit.item(value))
    for table in (x for x in document.values() if isinstance(x, Table)):
        for name, value in table.items():
            if name in units:
                value.comment(units[name])
    return tomlkit.dumps(document)


TAG = "table "
"""Start of the tags with which pydantic names a table if a field allows several tables."""


def significant(value: float, digits: int = 9) -> float:
    """Returns `value` rounded to `digits` significant digits, for a file."""
    return float(f"{value:.{digits}g}")


def _unit_advice(text: str, error: tomllib.TOMLDecodeError) -> str:
    """Returns advice if the line of the error has a unit after a number; otherwise returns ""."""
    at = re.search(r"at line (\d+)", str(error))
    lines = text.split("\n")
    line = lines[int(at[1]) - 1] if at and int(at[1]) <= len(lines) else ""
    number = re.search(r"=\s*([-+]?\d[\d_.]*(?:[eE][-+]?\d+)?)\s*([^\W\d_][^\s#]*)", line)
    if not number:
        return ""
    return f"; write numbers in SI units, without the unit: convert {number[1]}, remove {number[2]}"


def field_at(
    table: type[BaseModel], location: Sequence[str | int], content: Any = None
) -> tuple[type[BaseModel], FieldInfo | None]:
    """Returns the innermost table and the field at a key such as ("trials", 0, "phase").

    If a field allows several tables, the location may contain the tag of one of them after the
    field. Without a tag, it is the table with the `kind` in the `content`, or the first table with
    the next key.
    """
    field, tables = None, [table]
    for key in location:
        part = str(key)
        if isinstance(content, dict) and "kind" in content:
            tables = [x for x in tables if _is_kind(x, content["kind"])] or tables
        content = _entry(content, key)
        if part.startswith(TAG):
            tables = [x for x in tables if part == x.tag()]  # type: ignore[attr-defined]
        elif not part.isdigit():
            table = next((x for x in tables if part in x.model_fields), tables[0])
            field = table.model_fields.get(part)
            if field is None:
                break
            tables = tables_in(field) or [table]
    return tables[0] if field else table, field


def _is_kind(table: type[BaseModel], kind: Any) -> bool:
    field = table.model_fields.get("kind")
    return field is not None and kind in get_args(field.annotation)


def _entry(content: Any, key: str | int) -> Any:
    """Returns an entry of a table or list, or None. The tag of a table is no entry."""
    if str(key).startswith(TAG):
        return content
    try:
        return content[key]
    except (KeyError, IndexError, TypeError):
        return None


def tables_in(field: FieldInfo) -> list[type[BaseModel]]:
    """Returns the tables that a field allows, itself or as entries of a list."""
    return _tables_of(field.annotation)


def _tables_of(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [table for inner in get_args(annotation) for table in _tables_of(inner)]


def quantity_of(field: FieldInfo | None) -> Quantity | None:
    """Returns the unit and range of a field, or None for a field without unit and range."""
    candidates = list(field.metadata) if field is not None else []
    for inner in getattr(getattr(field, "annotation", None), "__args__", ()):
        candidates += getattr(inner, "__metadata__", ())
    return next((item for item in candidates if isinstance(item, Quantity)), None)


def quantity_in(table: type[BaseModel], name: str) -> Quantity:
    """Returns the unit and range of the field `name` of a table, which must have both."""
    quantity = quantity_of(table.model_fields[name])
    assert quantity is not None
    return quantity


def _message(table: type[BaseModel], error: Any, content: Any) -> str:
    """Returns the message for one error of pydantic."""
    location = tuple(part for part in error["loc"] if not str(part).startswith("function-"))
    owner, field = field_at(table, location, content)
    where = ".".join(str(part) for part in location if not str(part).startswith(TAG))
    quantity = quantity_of(field)
    kind, given = error["type"], repr(error["input"])
    if kind == "table":
        return ".".join(part for part in (where, error["msg"]) if part)
    if kind == "missing":
        if field is not None and tables_in(field):
            needed = [name for name, x in owner.model_fields.items() if x.is_required()]
            many = get_origin(field.annotation) is tuple
            name = f"[[{where}]]" if many else f"[{where}]"
            return f"{where}: missing; add a table {name} with {', '.join(needed)}"
        unit = f" in {quantity.unit}" if quantity and quantity.unit else ""
        return f"{where}: missing; add a value{unit}"
    if kind == "extra_forbidden":
        close = difflib.get_close_matches(str(location[-1]), owner.model_fields, 1)
        advice = f"did you mean {close[0]}?" if close else "remove this key"
        return f"{where}: unknown key; allowed {', '.join(owner.model_fields)}; {advice}"
    if kind in ("quantity", "file_name", "name", "too_short", "too_long"):
        return f"{where}: {error['msg']}"
    if kind == "float_type" and quantity:
        return f"{where}: given {given}; allowed a number, {quantity.allowed}"
    if kind == "literal_error":
        return f"{where}: given {given}; allowed {error['ctx']['expected']}"
    if len(given) > 60:
        given = given[:57] + "..."
    return f"{where}: given {given}; {error['msg'][0].lower()}{error['msg'][1:]}"


def validate(table: type[TableType], content: Any, source: str) -> TableType:
    """Returns `content` as a `table`. Raises `InputError` with source, key and allowed values."""
    try:
        return table.model_validate(content)
    except ValidationError as failure:
        errors = failure.errors(include_url=False)
        # A misspelt key is both unknown and missing; the error for the unknown key comes first.
        errors.sort(key=lambda error: error["type"] != "extra_forbidden")
        messages = [_message(table, error, content) for error in errors]
        more = f" (number of other errors: {len(messages) - 1})" if len(messages) > 1 else ""
        raise InputError(f"{source}: {messages[0]}{more}") from None
