"""Driving in the simulator."""

from __future__ import annotations

import asyncio
import math

import pytest
from circle import circle

import singletrack
from singletrack import ArmError, Car, Rejected, Simulator

ON_CIRCLE = {"point": (1.0, 0.0, math.pi / 2)}


def test_the_same_seed_gives_the_same_bits() -> None:
    runs = [circle(Car("sim", seed=7, **ON_CIRCLE), 5.0) for _ in range(2)]
    assert runs[0] == runs[1]
    assert runs[0] != circle(Car("sim", seed=8, **ON_CIRCLE), 5.0)


def test_actuation_is_followed_within_the_limits() -> None:
    car = Car("sim")
    with car.drive() as drive:
        for state in drive:
            drive.actuate(0.2, 0.5)
            if state.drive_time_s > 2.0:
                break
        assert abs(state.steering_rad - 0.2) < 1e-9 and abs(state.commanded_speed_m_s - 0.5) < 1e-9
        truth = car.status()["truth"]
        assert abs(truth["steering"] - 0.2) < 0.02 and abs(truth["speed"] - 0.5) < 0.1
        for state in drive:
            drive.actuate(1.5, 50.0)
            if state.drive_time_s > 4.0:
                break
        assert state.steering_rad <= 0.45 and state.commanded_speed_m_s <= 1.5


def test_a_rate_and_an_acceleration_are_actuation_too() -> None:
    with Car("sim").drive() as drive:
        for state in drive:
            drive.actuate(steering_rate_rad_s=0.1, acceleration_m_s2=0.2)
            if state.drive_time_s >= 1.0:
                break
        assert 0.08 < state.steering_rad < 0.11 and 0.17 < state.commanded_speed_m_s < 0.21
        with pytest.raises(TypeError):
            drive.actuate(0.1)


def test_a_trajectory_is_followed() -> None:
    errors = []
    with Car("sim").drive() as drive:
        start = None
        for state in drive:
            if start is None:
                start, origin = state.t_s, state.point_m
            if state.tick % 5 == 0:
                ahead = [state.t_s + 0.1 * step for step in range(10)]
                drive.trajectory(
                    [(t, origin[0] + 0.3 * (t - start), origin[1], 0.3, 0.0) for t in ahead]
                )
            if state.t_s - start > 3.0:
                errors.append(math.dist(state.point_m, (origin[0] + 0.3 * (state.t_s - start), origin[1])))
            if state.t_s - start > 6.0:
                break
    assert len(errors) > 200 and max(errors) < 0.06


def test_leaving_the_block_stops_the_car_also_by_an_exception() -> None:
    car = Car("sim")
    with pytest.raises(ZeroDivisionError), car.drive() as drive:
        for state in drive:
            drive.point_velocity(0.5, 0.0)
            if state.speed_m_s > 0.3:
                raise ZeroDivisionError
    assert car.state.mode in ("ready", "idle")
    assert abs(car.status()["truth"]["speed"]) < 0.01
    # And it can be driven again.
    with car.drive() as drive:
        assert next(drive).driving


def test_what_is_not_finite_is_rejected_and_stops_the_car() -> None:
    car = Car("sim")
    for bad in (math.nan, math.inf):
        with pytest.raises(Rejected) as rejected, car.drive() as drive:
            next(drive)
            drive.point_velocity(bad, 0.0)
        assert rejected.value.word == "not-finite"
        assert car.state.mode in ("ready", "idle")


def test_a_controller_that_stops_sending_ends_the_drive() -> None:
    with Car("sim").drive() as drive:
        for count, _ in enumerate(drive):
            if count < 100:
                drive.point_velocity(0.4, 0.0)
            assert count < 200
    assert drive.reason == "setpoint-stale"


def test_full_speed_at_the_fence_ends_inside_of_it() -> None:
    simulator = Simulator(
        configuration={"fence.corners_m": [[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]]}
    )
    with Car(simulator).drive() as drive:
        for state in drive:
            drive.actuate(0.0, 1.5)
            assert state.t_s < 30.0
    assert drive.reason is not None and "fence" in drive.reason
    assert abs(simulator.truth()["x"]) < 3.0


def test_a_car_that_can_not_be_armed_says_why() -> None:
    simulator = Simulator()
    simulator.fault("cameras", "silent")
    with pytest.raises(ArmError, match="no-pose"), Car(simulator).drive(timeout=4.0):
        pass


def test_faults_reach_the_system() -> None:
    simulator = Simulator()
    with Car(simulator).drive() as drive:
        for state in drive:
            drive.point_velocity(0.4, 0.0)
            if state.drive_time_s > 1.0:
                simulator.fault("imu", "silent")
            assert state.t_s < 20.0
    assert drive.reason is not None and "imu" in drive.reason
    with pytest.raises(ValueError, match="unknown fault"):
        simulator.fault("imus", "silent")


def test_truth_and_belief_are_two_things() -> None:
    simulator = Simulator(truth={"servo.centre_us": 1540, "vehicle": {"friction": 0.5}})
    assert "centre_us = 1500" in simulator.configuration()
    with Car(simulator).drive() as drive:
        for state in drive:
            drive.actuate(0.0, 0.4)
            if state.drive_time_s > 1.0:
                break
    assert abs(simulator.truth()["steering"] - 0.05) < 0.01
    with pytest.raises(ValueError, match="servo.lag_ms"):
        Simulator(truth={"servo.lag_ms": -1.0})
    with pytest.raises(ValueError, match="friktion"):
        Simulator(truth={"vehicle.friktion": 1.0})


def test_asyncio_drives_too() -> None:
    async def drives() -> singletrack.State:
        async with Car("sim").drive() as drive:
            async for state in drive:
                drive.point_velocity(0.4, 0.0)
                if state.drive_time_s > 1.0:
                    return state
        raise AssertionError(drive.reason)

    assert asyncio.run(drives()).speed_m_s > 0.3


def test_a_daemon_that_is_not_there_is_named() -> None:
    with pytest.raises(ConnectionError, match="/nowhere.sock"):
        Car("/nowhere.sock")


TUNING = {"tuning": {"enabled": True, "gain_per_s": [0.5, 4.0], "point_distance_m": [0.3, 0.4]}}


def test_a_simulated_car_is_tuned_within_the_bounds() -> None:
    car = Car("sim", configuration=TUNING)
    assert car.state.gain_per_s is not None
    car.tune(gain=2.0, point_distance=0.4)
    assert car.simulator is not None
    state = car.simulator.step(300)
    assert state.gain_per_s == (2.0, 2.0) and state.point_distance_m == 0.4
    car.tune(gain=(1.0, 1.5))
    assert car.simulator.step().gain_per_s == (1.0, 1.5)
    for wrong in (9.0, math.nan):
        with pytest.raises(singletrack.SingletrackError, match="between 0.5 and 4"):
            car.tune(gain=wrong)
    with pytest.raises(singletrack.SingletrackError, match="nothing to tune"):
        car.tune()


def test_a_car_that_can_not_be_tuned_says_what_to_set() -> None:
    car = Car("sim")
    assert car.state.gain_per_s is None and math.isnan(car.state.point_distance_m)
    with pytest.raises(singletrack.SingletrackError, match="tuning.enabled = true"):
        car.tune(gain=2.0)
