"""Records and mathematics for notebooks."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest

import singletrack
from singletrack import Car, law, model, stability


def test_a_record_of_a_simulation_is_read_into_arrays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "drive.mcap"
    speeds = []
    with Car("sim", record=path, seed=5) as car, car.drive() as drive:
        for state in drive:
            drive.point_velocity(0.4, 0.1)
            speeds.append(state.commanded_speed_m_s)
            if state.drive_time_s > 2.0:
                break
    record = singletrack.read(path)
    assert record.finished and record.damage is None and record.seed == 5
    ticks = record["tick"]
    assert len(ticks["estimate.yaw_rad"]) == len(ticks["start_ns"])
    commanded = np.asarray(ticks["actuation.speed_m_s"])
    assert set(speeds) <= set(commanded.tolist())
    # A frame begins a tick up to 3 ms before its deadline; the deadlines are a period apart.
    apart = np.diff(record.seconds("tick"))
    assert np.allclose(apart, 0.01, atol=3.6e-3)
    assert apart.mean() == pytest.approx(0.01, abs=5e-5)
    assert "driving" in record["tick"]["mode"]
    assert list(singletrack.read(path, ["telemetry"])) == ["telemetry"]
    ticks_count = len(ticks["start_ns"])
    assert repr(record).startswith(f"<Record {str(path)!r}: {record.duration:.2f} s, ended: requested, ")
    assert f", {ticks_count} tick, " in repr(record) and record.duration > 2.0
    with pytest.raises(KeyError, match="did you mean tick"):
        record["/singletrack/tik"]
    with pytest.raises(KeyError, match="did you mean estimate.yaw_rad"):
        ticks["estimate.yaw"]
    for frame in (record.to_pandas, record.to_polars):
        module = frame.__name__.removeprefix("to_")
        monkeypatch.setitem(sys.modules, module, None)
        with pytest.raises(ImportError, match=rf"python\[{module}\]"):
            frame()
    with pytest.raises(ValueError, match="no topic"):
        singletrack.read(path, ["tack"])
    with pytest.raises(OSError):
        singletrack.read(tmp_path / "none.mcap")


def test_an_unfinished_record_is_read_up_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    simulator = singletrack.Simulator(record=path)
    simulator.step(400)
    simulator.close()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[:-20_000])
    record = singletrack.read(cut)
    assert not record.finished and "not finished" in repr(record) and "no drive" in repr(record)
    assert 0 < len(record["tick"]["start_ns"]) <= 400


def test_the_models_agree_where_they_must() -> None:
    state = [0.0, 0.0, 0.3, 0.05, 0.01]
    linear = model.derivative(state, 0.8, 0.02)
    assert linear.shape == (5,)
    for kind in ("saturating", "relaxed"):
        assert np.allclose(model.derivative(state, 0.8, 0.02, kind=kind), linear, rtol=0.02)
    rows = model.simulate(np.zeros(5), np.full(500, 0.5), 0.1)
    assert rows.shape == (501, 5)
    # Steady cornering: the yaw rate of the linear model.
    assert np.all(np.abs(model.derivative(rows[-1], 0.5, 0.1, kind="relaxed")[3:]) < 1e-6)
    with pytest.raises(ValueError, match="mass_kg"):
        model.derivative(state, 0.8, 0.0, vehicle=model.Vehicle(mass_kg=0.0))


def test_the_law_moves_p_as_wanted() -> None:
    speed, rate = law.front_point(0.0, 0.0, 0.0, 0.0, (0.5, 0.07))
    assert speed == 0.5 and math.isclose(rate, 0.2)
    with pytest.raises(ValueError, match="singularity"):
        law.front_point(0.0, 0.0, 1.5, 0.0, (0.5, 0.0))
    assert law.point(1.0, 2.0, 0.0, 0.0) == pytest.approx((1.4868, 2.0))
    assert law.velocity_point(0.0, 0.0, 0.0, (0.5, 0.0))[0] == 0.5


def test_stability_is_that_of_the_paper() -> None:
    # The paper's threshold: 0.136 mm of the centre of mass at p = 0.35 m.
    assert stability.is_stable(0.8)
    assert np.all(stability.eigenvalues(0.8).real < 0)
    assert stability.eigenvalues(0.8).shape == (4,)
    points = stability.hopf_points(0.8, law="velocity-point")
    assert points and all("criticality" in point for point in points)
    radius, margin = stability.sampled(0.8, delay=0.03, position_gain=1.0)
    assert radius < 1.0 and (margin is None or margin > 0.03)
    smallest = stability.smallest_point_distance((-0.1, 0.1))
    assert smallest is not None
    beyond = stability.critical_speed((-0.1, 0.1), point_distance=1.01 * smallest)
    below = stability.critical_speed((-0.1, 0.1), point_distance=0.9 * smallest)
    assert beyond is None and below is not None
