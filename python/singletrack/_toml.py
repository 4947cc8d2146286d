"""Just enough TOML to pass tables of configuration on."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from typing import Any, Union

#: Keys of a configuration: nested or with dots, as TOML text, or a path of a TOML file.
Table = Union[Mapping[str, Any], str, "os.PathLike[str]", None]


def text(table: Table) -> str:
    """The TOML text of a table."""
    if table is None:
        return ""
    if isinstance(table, os.PathLike):
        with open(table, encoding="utf-8") as file:
            return file.read()
    if isinstance(table, str):
        if "\n" not in table and "=" not in table and table.endswith(".toml"):
            with open(table, encoding="utf-8") as file:
                return file.read()
        return table
    if not isinstance(table, Mapping):
        raise TypeError(f"a table is a dictionary, TOML text or a path, not {table!r}")
    return "\n".join(f"{_key(key)} = {_value(value)}" for key, value in _nest(table).items())


def _nest(table: Mapping[str, Any]) -> dict[str, Any]:
    nested: dict[str, Any] = {}
    for key, value in table.items():
        place = nested
        *sections, last = key.split(".")
        for section in sections:
            place = place.setdefault(section, {})
        if isinstance(value, Mapping):
            place.setdefault(last, {}).update(_nest(value))
        else:
            place[last] = value
    return nested


def _key(key: str) -> str:
    return json.dumps(key)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, str):
        return json.dumps(value)
    if isinstance(value, Mapping):
        inner = ", ".join(f"{_key(key)} = {_value(item)}" for key, item in value.items())
        return "{" + inner + "}"
    if isinstance(value, Sequence) or hasattr(value, "tolist"):
        items = value.tolist() if hasattr(value, "tolist") else value
        if isinstance(items, Sequence):
            return "[" + ", ".join(_value(item) for item in items) + "]"
        return _value(items)
    return repr(float(value))
