"""docs/python-api.md is the package's own documentation; SINGLETRACK_RENEW=1 writes it."""

from __future__ import annotations

import inspect
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium

import singletrack
from singletrack import cameras, gym, law, model, stability

PAGE = Path(__file__).parents[2] / "docs/python-api.md"
MODULES = (singletrack, cameras, gym, law, model, stability)
#: Classes that a program makes itself.
CALLED = ("Cameras", "Car", "Fleet", "Simulator", "SingletrackEnv", "SingletrackVectorEnv", "Vehicle")
HEAD = """# Python API

The public names of the package `singletrack`. How to use them: [Python](python.md).

This page is generated from the package's docstrings by `python/tests/test_api_page.py`.
"""


def markdown(text: str) -> str:
    """A docstring: its sections as lists, its tables and examples as they are."""
    text = re.sub(r":\w+:`(.*?)`", r"`\1`", inspect.cleandoc(text)).replace("``", "`")
    text = re.sub(r"::$", ":", text, flags=re.MULTILINE)
    lines, section, fence = [], "", False
    for line in text.split("\n"):
        if line.startswith("=====") and not fence:
            lines.append("```text")
            fence = True
        elif fence and not line:
            lines.append("```")
            fence = False
        if line in ("Args:", "Returns:", "Raises:"):
            section = line
            lines.append({"Args:": "Arguments:"}.get(line, line) + "\n")
        elif section and (found := re.match(r"    (\w+): (.*)", line)) and section != "Returns:":
            lines.append(f"- `{found[1]}`: {found[2]}")
        elif section and line.startswith("    "):
            lines.append(("" if section == "Returns:" else "  ") + line.strip())
        else:
            section = section if line else ""
            lines.append(line)
    return "\n".join([*lines, *["```"] * fence])


def fields(kind: type) -> Iterator[str]:
    """The attributes that a comment `#:` describes."""
    source = inspect.getsource(kind)
    for text, name in re.findall(r"((?:^ *#: .*\n)+) *(?:self\.)?(\w+): ", source, re.MULTILINE):
        yield f"- `{name}`: {markdown(' '.join(re.findall('#: (.*)', text)))}"


def signature(thing: Any) -> str:
    """Names and defaults; what they are stands in the text."""
    known = inspect.signature(thing)
    names = [one.replace(annotation=one.empty) for one in known.parameters.values()]
    names = [one for one in names if one.name != "self"]
    return str(known.replace(parameters=names, return_annotation=known.empty))


def entry(name: str, thing: Any) -> Iterator[str]:
    """A function, or a class with its attributes and members."""
    if inspect.isfunction(thing):
        yield f"### `{name}{signature(thing)}`"
    else:
        yield f"### `{name}{signature(thing) if name in CALLED else ''}`"
    yield markdown(thing.__doc__)
    if not inspect.isclass(thing):
        return
    if issubclass(thing, gymnasium.Env):
        yield f"The options: `{signature(gym._options)}`"
    yield "\n".join(fields(thing))
    for member, value in vars(thing).items():
        if inspect.isfunction(value) and not member.startswith("_"):
            yield f"**`{member}{signature(value)}`**: {markdown(value.__doc__ or '')}"
        elif isinstance(value, property):
            yield f"**`{member}`**: {markdown(value.__doc__ or '')}"


def page() -> str:
    parts = [HEAD]
    for module in MODULES:
        public = [name for name in getattr(module, "__all__", vars(module)) if name[0] != "_"]
        things = {name: getattr(module, name) for name in public}
        parts += [f"## `{module.__name__}`", markdown(module.__doc__ or "")]
        for name, thing in things.items():
            if getattr(thing, "__module__", "").startswith(module.__name__) and thing.__doc__:
                parts += entry(name, thing)
    return "\n\n".join(filter(None, map(str.strip, parts))) + "\n"


def test_the_page_of_the_api_is_that_of_the_docstrings() -> None:
    text = page()
    if os.environ.get("SINGLETRACK_RENEW") == "1":
        PAGE.write_text(text)
    assert PAGE.read_text() == text, (
        "docs/python-api.md is old: SINGLETRACK_RENEW=1 pytest tests/test_api_page.py renews it"
    )
