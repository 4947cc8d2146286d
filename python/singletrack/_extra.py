"""Packages of the extras, which are imported when they are used."""

from __future__ import annotations

from importlib import import_module
from typing import Any


def load(module: str, extra: str) -> Any:
    """Imports a module; its absence is an error that names the extra."""
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        raise ImportError(
            f"{module} is not installed: in a clone, pip install './python[{extra}]'"
        ) from error
