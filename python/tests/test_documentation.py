"""The Python of docs/python.md runs, in its order."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

PAGE = Path(__file__).parents[2] / "docs/python.md"


def test_the_page_runs_from_start_to_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "page"}
    page = PAGE.read_text()
    blocks = list(re.finditer(r"^```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL))
    assert len(blocks) >= 5
    for block in blocks:
        line = page.count("\n", 0, block.start()) + 1
        exec(compile("\n" * line + block[1], str(PAGE), "exec"), names)
    # The circle of the first block came to its end.
    assert names["drive"].reason == "requested"
    assert (tmp_path / "drive.mcap").is_file()


def test_the_page_names_every_example_and_lab() -> None:
    page = PAGE.read_text()
    for path in [*PAGE.parents[1].glob("python/examples/*.py"), *PAGE.parents[1].glob("python/notebooks/*")]:
        assert f"`{path.name}`" in page, path
