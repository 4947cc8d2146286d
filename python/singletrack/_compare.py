"""The comparison of controllers, with one of a program."""

from __future__ import annotations

import csv
import inspect
import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from . import _native
from ._state import Pair, State, state

#: The paths on which no parameter of a compared controller was chosen.
_TEST_PATHS = ("ellipse", "double-lane-change", "corners", "wide-eight", "stop")
_WITH = ("p-compensated", "lqi-compensated", "pure-pursuit-compensated", "stanley-compensated")


class Path:
    """A path of the comparison: where the controller's point should be at a time."""

    def __init__(self, native: _native.Course) -> None:
        self._native = native

    @property
    def until(self) -> float:
        """The time until which a drive is counted, in s."""
        return self._native.until

    def at(self, drive_time: float) -> tuple[Pair, Pair]:
        """Position (m) and velocity (m/s) at a :attr:`State.drive_time_s` (s), or one to come."""
        return self._native.at(drive_time)


@dataclass(frozen=True)
class Comparison:
    """The result of :func:`compare`. Printed, it is a table per path, speed and condition."""

    #: The table of `singletrack compare`, in Markdown.
    markdown: str
    #: The same with every digit; see docs/compare.md.
    csv: str

    @property
    def rows(self) -> list[dict[str, Any]]:
        """The lines of the CSV by their columns; numbers are floats, absent ones NaN."""
        return [
            {name: _value(name, text) for name, text in row.items()}
            for row in csv.DictReader(io.StringIO(self.csv))
        ]

    def __str__(self) -> str:
        return self.markdown


_WORDS = ("controller", "path", "condition", "worst_condition", "stop_reasons")


def _value(name: str, text: str) -> Any:
    return text if name in _WORDS else float(text) if text else math.nan


def compare(
    controller: Callable[..., Any],
    *,
    drives: Literal["velocity", "steering"] = "velocity",
    point: Literal["p", "front-axle", "rear-axle"] = "p",
    name: str | None = None,
    controllers: Sequence[str] = _WITH,
    paths: Sequence[str] = _TEST_PATHS,
    speeds: Sequence[float] = (1.0, 1.5),
    conditions: Sequence[str] = ("nominal",),
    count: int = 3,
    first_seed: int = 1,
    threads: int | None = None,
) -> Comparison:
    """Compares a controller with those of `singletrack compare`: same car, seeds and paths.

    Args:
        controller: A function of ``(state, path)``, or a class that is made with the
            :class:`Path` of each drive and then called with each :class:`State`. It returns two
            numbers, which act in the next tick.
        drives: What these are: ``"velocity"``, that of P in the world (m/s), from which the law
            and its compensation steer; or ``"steering"``, steering angle (rad) and speed (m/s).
        point: The point that should be on the path: its distance is the error.
        name: Name of the row; that of the function or class if left out.
        controllers: Controllers beside it; see docs/compare.md.
        paths: Paths; by default those on which no controller was tuned.
        speeds: Speeds, in m/s.
        conditions: Conditions, such as ``"trim-3deg"``.
        count: Number of seeds of a row. One is not ranked.
        first_seed: The first seed.
        threads: Threads for the other controllers; one per processor if left out.
    """
    if drives not in ("velocity", "steering"):
        raise ValueError(f'drives is {drives!r}: use "velocity" or "steering"')
    is_class = inspect.isclass(controller)
    keys = _velocity if drives == "velocity" else _steering

    def begin(native: _native.Course) -> Callable[[dict[str, Any]], dict[str, Any]]:
        path = Path(native)
        if is_class:
            decide = controller(path)
            return lambda values: keys(*decide(state(values)))
        return lambda values: keys(*controller(state(values), path))

    plan = {
        "controllers": ["yours", *controllers],
        "paths": list(paths),
        "speeds_m_s": [float(speed) for speed in speeds],
        "conditions": list(conditions),
        "first_seed": first_seed,
        "seeds": count,
        "delay_seeds": count,
    }
    table, markdown = _native.compare(
        begin,
        plan,
        name=getattr(controller, "__name__", "yours") if name is None else name,
        point=point,
        threads=threads,
    )
    return Comparison(markdown=markdown, csv=table)


def _velocity(vx: float, vy: float) -> dict[str, Any]:
    return {"velocity_m_s": [float(vx), float(vy)]}


def _steering(steering: float, speed: float) -> dict[str, Any]:
    return {"steering_rad": float(steering), "speed_m_s": float(speed)}
