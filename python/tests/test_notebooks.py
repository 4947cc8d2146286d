"""The notebooks of the labs run, and their exercises tell a right answer from a wrong one."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from answers import ANSWERS
from matplotlib import pyplot

from singletrack.exercise import Student

#: The figures that each draws.
FIGURES = {"1-law": 2, "2-centre-of-mass": 2, "3-delay": 2, "4-faults": 1}

FOLDER = Path(__file__).parent.parent / "notebooks"


def cells(name: str) -> list[tuple[str, str]]:
    """Kind and source of each cell of code: ``answer``, ``check`` or nothing."""
    notebook = json.loads((FOLDER / f"{name}.ipynb").read_text())
    return [
        (*cell["metadata"].get("tags", []), "")[:1] + ("".join(cell["source"]),)
        for cell in notebook["cells"]
        if cell["cell_type"] == "code"
    ]


@pytest.mark.parametrize("name", sorted(ANSWERS))
def test_a_notebook_runs_with_its_exercises(name: str) -> None:
    names: dict[str, Any] = {"__name__": "notebook"}

    def run(source: str) -> None:
        exec(compile(source, name, "exec"), names)

    pyplot.close("all")
    answers = iter(ANSWERS[name])
    blank = right = wrong = ""
    for kind, source in cells(name):
        if kind == "answer":
            blank, (right, wrong) = source, next(answers)
            assert "..." in blank
            continue
        if kind == "check":
            for other in (blank, wrong):
                run(other)
                with pytest.raises(AssertionError):
                    run(source)
            run(right)
        run(source)
    assert next(answers, None) is None, "an answer without an exercise"
    figures = [pyplot.figure(number) for number in pyplot.get_fignums()]
    assert len(figures) == FIGURES[name]
    for axes in (axes for figure in figures for axes in figure.axes):
        assert axes.lines and (axes.get_ylabel() or axes.get_xlabel())


def test_every_notebook_has_its_answers() -> None:
    assert {path.stem for path in FOLDER.glob("*.ipynb")} == set(ANSWERS)


def test_the_numbers_of_a_student_belong_to_the_name() -> None:
    ada = Student("Ada Lovelace")
    assert ada.number("1.2", 1.0, 0.1, 11) == Student(" adaLOVELACE ").number("1.2", 1.0, 0.1, 11)
    grid = {round(1.0 + 0.1 * index, 6) for index in range(11)}
    names = [f"student {index}" for index in range(200)]
    assert {Student(name).number("1.2", 1.0, 0.1, 11) for name in names} == grid
    with pytest.raises(ValueError, match="a student has a name"):
        Student(" - ")
