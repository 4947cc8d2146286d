"""The functional mock-up units, in an importer of another project."""

from __future__ import annotations

import ctypes
import math
import os
import subprocess
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu

from singletrack import Simulator
from singletrack._car import SimulatedCar

CIRCLE = {"kind": "circle", "radius_m": 1.0, "angular_velocity_rad_s": 0.5}


@pytest.fixture(scope="module")
def units(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("units")
    subprocess.run([os.environ["SINGLETRACK_FMU"], folder], check=True)
    return folder


class Unit:
    """An instance of a unit, and what it has logged."""

    def __init__(self, folder: Path, name: str, token: str | None = None) -> None:
        path = str(folder / f"{name}.fmu")
        description = fmpy.read_model_description(path)
        self.references = {it.name: it.valueReference for it in description.modelVariables}
        self.fmu = FMU3Slave(
            guid=token or description.instantiationToken,
            unzipDirectory=fmpy.extract(path),
            modelIdentifier=name,
            instanceName="car",
        )
        self.log: list[str] = []
        self.fmu.instantiate(logMessage=lambda _, status, kind, text: self.log.append(text.decode()))
        self.time = 0.0

    def start(self) -> Unit:
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        return self

    def set(self, **values: Any) -> None:
        for name, value in values.items():
            of_type = self.fmu.setString if isinstance(value, str) else self.fmu.setFloat64
            of_type([self.references[name]], [value])

    def get(self, *names: str) -> list[float]:
        values: list[float] = self.fmu.getFloat64([self.references[name] for name in names])
        return values

    def text(self, name: str) -> str:
        value: str = self.fmu.getString([self.references[name]])[0]
        return value

    def drive(self, seconds: float, step: float = 0.01) -> list[float]:
        for _ in range(round(seconds / step)):
            self.fmu.doStep(self.time, step)
            self.time += step
        return self.get("x", "y", "yaw", "steering", "speed", "battery_v")

    def refused(self, call: Callable[[], Any]) -> tuple[int, str]:
        with pytest.raises(FMICallException) as error:
            call()
        return error.value.status, self.log.pop()


def test_the_units_are_valid_and_their_bytes_are_the_same_again(
    units: Path, tmp_path: Path
) -> None:
    subprocess.run([os.environ["SINGLETRACK_FMU"], tmp_path], check=True)
    names = sorted(path.name for path in units.iterdir())
    assert names == ["singletrack_car.fmu", "singletrack_system.fmu"]
    for name in names:
        assert validate_fmu(str(units / name)) == []
        assert (units / name).read_bytes() == (tmp_path / name).read_bytes()


@pytest.mark.parametrize("circle", [False, True])
def test_the_system_has_the_bits_of_the_simulator(units: Path, circle: bool) -> None:
    simulator = Simulator(seed=3, reference=CIRCLE if circle else None, start=(1.0, -0.48, 1.6))
    if circle:
        while simulator.mode != "ready":
            simulator.step()
        simulator.arm()
        while simulator.mode != "driving":
            simulator.step()
    else:
        SimulatedCar(simulator).begin(15.0, threading.Event())
    begin, ticks = simulator.now, []
    while simulator.now < begin + 3.0:
        ticks.append((simulator.now - begin, simulator.state))
        if not circle:
            simulator._native.setpoint({"velocity_m_s": (0.5, 0.2)})
        simulator.step()
    start: dict[str, Any] = {"seed": 3, "start_x": 1.0, "start_y": -0.48, "start_yaw": 1.6}
    start |= {"velocity_x": 0.5, "velocity_y": 0.2}
    if circle:
        inline = ", ".join(f"{key} = {value!r}" for key, value in CIRCLE.items())
        start["configuration"] = f"reference = {{ {inline} }}"
    path = str(units / "singletrack_system.fmu")
    rows = fmpy.simulate_fmu(path, stop_time=2.99, output_interval=0.01, start_values=start)
    assert len(rows) == 300
    for row in rows:
        state = [state for time, state in ticks if time <= row["time"] + 1e-9][-1]
        for name, value in (
            ("estimate_x", state.x_m),
            ("estimate_y", state.y_m),
            ("estimate_yaw", state.yaw_rad),
            ("estimate_yaw_rate", state.yaw_rate_rad_s),
            ("estimate_sideslip", state.sideslip_rad),
            ("estimate_speed", state.speed_m_s),
            ("command_steering", state.steering_rad),
            ("command_speed", state.commanded_speed_m_s),
        ):
            assert row[name] == value, (row["time"], name)
        assert row["driving"]
    assert math.hypot(rows["x"][-1] - 1.0, rows["y"][-1] + 0.48) > 0.8
    error = np.hypot(rows["estimate_x"] - rows["x"], rows["estimate_y"] - rows["y"])
    assert error.max() < 0.02


def test_the_car_alone_obeys_its_pulses(units: Path) -> None:
    car = Unit(units, "singletrack_car").start()
    car.set(servo_us=1_500 - 0.2 * 800, esc_us=1_600)
    car.drive(2.0)
    # An ESC that saw no neutral is not armed.
    assert car.get("speed", "steering") == [0.0, pytest.approx(0.2)]
    car.set(esc_us=1_500)
    car.drive(1.1)
    car.set(esc_us=1_570)
    car.drive(3.0)
    speed, rate, sideslip, steering = car.get("speed", "yaw_rate", "sideslip", "steering")
    # The wheelbase of the simulated car; it turns as one without slip, but for what it slips.
    assert rate == pytest.approx(speed * math.cos(sideslip) * math.tan(steering) / 0.2735, rel=0.1)
    assert 0.1 < speed < 1.0


def test_instances_are_independent_and_start_again(units: Path) -> None:
    def driven(car: Unit) -> list[float]:
        car.start()
        car.drive(1.1)
        car.set(esc_us=1_560)
        return car.drive(0.5)

    cars = [Unit(units, "singletrack_car") for _ in range(2)]
    cars[1].set(truth="servo.centre_us = 1400", start_x=2.0)
    first, other = (driven(car) for car in cars)
    assert first[3] == 0.0 and first[4] > 0.1
    assert other[3] == pytest.approx(-0.125) and other[0] > 2.0
    assert cars[0].drive(0.0) == first
    for car in cars:
        car.fmu.reset()
        car.time = 0.0
        assert driven(car) == first


def test_what_is_wrong_is_refused_with_its_name_value_and_range(units: Path) -> None:
    DISCARD, ERROR = 2, 3
    car = Unit(units, "singletrack_car")
    fmu = car.fmu
    refused = car.refused
    assert refused(lambda: car.set(servo_us=math.nan)) == (
        DISCARD,
        "fmi3SetFloat64: servo_us is NaN: give 0 to 2500 us",
    )
    assert refused(lambda: car.set(start_x=math.inf))[0] == DISCARD
    assert refused(lambda: car.set(x=1.0)) == (
        ERROR,
        "fmi3SetFloat64: x is an output: it can't be set",
    )
    status, text = refused(lambda: fmu.getFloat64([99]))
    assert (status, "no variable 99" in text) == (ERROR, True)
    status, text = refused(lambda: fmu.getFloat64([car.references["truth"]]))
    assert (status, "truth is a String" in text) == (ERROR, True)
    assert "not offered" in refused(lambda: fmu.getInt32([1]))[1]
    assert "a text is missing" in refused(lambda: fmu.setString([1], [None]))[1]
    # What the configuration does not have is named at the start, and can be mended.
    for name, wrong in (("configuration", "law.gian = 1"), ("truth", "servo.lag_ms = -1")):
        fmu.reset()
        car.set(**{name: wrong})
        fmu.enterInitializationMode()
        status, text = refused(fmu.exitInitializationMode)
        assert (status, wrong.split(" = ")[0].split(".")[1] in text) == (ERROR, True), text
    car.set(truth="")
    fmu.exitInitializationMode()
    for time, step, why in (
        (0.0, 3_600.0, "the step is 3600 s: give 1e-6 to 10 s"),
        (0.0, -0.01, "the step is -0.01 s"),
        (0.0, math.nan, "the step is NaN s"),
        (1.0, 0.01, "the step begins at 1 s: begin at 0 s"),
    ):
        status, text = refused(partial(fmu.doStep, time, step))
        assert (status, why in text) == (DISCARD, True), text
    car.drive(0.1)
    assert "before the first step" in refused(lambda: car.set(truth=""))[1]
    with pytest.raises(Exception, match="Failed to instantiate"):
        Unit(units, "singletrack_car", "another")
    system = Unit(units, "singletrack_system").start()
    assert "not offered" in system.refused(system.fmu.getFMUState)[1]
    assert "fmi3DoStep" in system.refused(lambda: system.fmu.doStep(0.0, math.inf))[1]
    # Null is no instance.
    fmu.component = ctypes.c_void_p()
    with pytest.raises(FMICallException):
        fmu.reset()


def test_a_system_that_leaves_its_fence_says_why_it_stands(units: Path) -> None:
    system = Unit(units, "singletrack_system").start()
    system.set(velocity_x=1.0)
    for _ in range(20):
        system.drive(1.0, 0.05)
        if system.text("mode") != "driving":
            break
    assert system.text("reason") == "outside-fence"
    assert system.drive(3.0, 0.5)[4] == 0.0
