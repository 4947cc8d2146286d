"""A controller of a program beside those of the comparison."""

from __future__ import annotations

import math
import re
import textwrap
from pathlib import Path
from typing import Any

import pytest
import singletrack

PAGE = Path(__file__).parents[2] / "docs/controllers.md"
SHORT: dict[str, Any] = {"paths": ["lane-change"], "speeds": [1.0], "count": 2}


def follow(state: singletrack.State, path: singletrack.Path) -> singletrack._state.Pair:
    (x, y), (vx, vy) = path.at(state.drive_time_s)
    return vx + 4.0 * (x - state.point_m[0]), vy + 4.0 * (y - state.point_m[1])


class Stanley:
    """With the reference's speed, for the front axle; it keeps to the line by time."""

    def __init__(self, path: singletrack.Path) -> None:
        self.path = path

    def __call__(self, state: singletrack.State) -> tuple[float, float]:
        (x, y), (vx, vy) = self.path.at(state.drive_time_s)
        front_x = state.x_m + 0.1368 * math.cos(state.yaw_rad)
        front_y = state.y_m + 0.1368 * math.sin(state.yaw_rad)
        heading = math.atan2(vy, vx) if math.hypot(vx, vy) > 1e-3 else state.yaw_rad
        left = (front_y - y) * math.cos(heading) - (front_x - x) * math.sin(heading)
        ahead = (front_x - x) * math.cos(heading) + (front_y - y) * math.sin(heading)
        steering = heading - state.yaw_rad - math.atan2(4.0 * left, max(state.speed_m_s, 0.2))
        return steering, max(0.0, math.hypot(vx, vy) - 2.0 * ahead)


def test_a_function_is_a_row_beside_ours() -> None:
    result = singletrack.compare(follow, controllers=["p-ff", "p-compensated"], **SHORT)
    own = {row["controller"]: row for row in result.rows if row["condition"] == "nominal"}
    assert list(own) == ["follow", "p-ff", "p-compensated"]
    assert all(row["stops"] == 0 and row["seeds"] == 2 for row in own.values())
    # It feeds the velocity forward with a higher gain.
    assert own["follow"]["rms_m"] < own["p-ff"]["rms_m"]
    assert "| follow |" in str(result)
    # The same again, to the bit.
    alone = singletrack.compare(follow, controllers=[], **SHORT)
    assert [row["rms_m"] for row in alone.rows if row["condition"] == "nominal"] == [
        own["follow"]["rms_m"]
    ]


def test_a_class_may_steer_and_choose_its_point() -> None:
    result = singletrack.compare(
        Stanley, drives="steering", point="front-axle", name="mine", controllers=[], **SHORT
    )
    row = result.rows[0]
    assert row["controller"] == "mine" and row["stops"] == 0
    assert 0.0 < row["rms_m"] < 0.05


def test_an_error_of_the_controller_comes_out() -> None:
    def wrong(state: singletrack.State, path: singletrack.Path) -> tuple[float, float]:
        raise ZeroDivisionError("mine")

    with pytest.raises(ZeroDivisionError, match="mine"):
        singletrack.compare(wrong, controllers=[], **SHORT)
    with pytest.raises(ValueError, match="use .*p-compensated"):
        singletrack.compare(follow, controllers=["pid"])
    with pytest.raises(ValueError, match="give one that no controller has"):
        singletrack.compare(follow, name="stanley")


def test_the_example_of_the_page_runs() -> None:
    blocks = re.findall(r"^ *```python\n(.*?)^ *```", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    (block,) = [block for block in blocks if "singletrack.compare" in block]
    block = textwrap.dedent(block)
    names: dict[str, Any] = {}
    exec(compile(block, str(PAGE), "exec"), names)
