"""The examples run, in short versions."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parent.parent / "examples"


def run(folder: Path, name: str, *arguments: str) -> str:
    program = [sys.executable, "-P", str(EXAMPLES / f"{name}.py"), *arguments]
    done = subprocess.run(program, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_p_control_comes_to_the_end_of_its_circle(tmp_path: Path) -> None:
    found = re.match(r"P is (.*) mm from the reference; requested", run(tmp_path, "p_control"))
    # The gyro vibrates as a real one does; without that P is within 10 mm.
    assert found and float(found[1]) < 20.0


def test_predictive_control_keeps_p_before_the_wall(tmp_path: Path) -> None:
    pytest.importorskip("osqp")
    found = re.match(r"(.*) mm beyond the wall", run(tmp_path, "mpc"))
    assert found and float(found[1]) < 3.0


def test_throughput_is_measured(tmp_path: Path) -> None:
    rows = run(tmp_path, "throughput", "--short").splitlines()[1:]
    assert len(rows) == 4 and all(float(row.split()[-1]) > 0 for row in rows)


def test_training_writes_a_policy_and_its_curve(tmp_path: Path) -> None:
    run(tmp_path, "train", "--short")
    assert (tmp_path / "policy.npz").is_file()
    assert len((tmp_path / "training.csv").read_text().splitlines()) == 3
