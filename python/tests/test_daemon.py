"""Driving through the control socket of a daemon in real time."""

from __future__ import annotations

import asyncio
import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from circle import circle
from conftest import BOARDS

from singletrack import ArmError, Car, Rejected
from singletrack._native import Connection
from singletrack._socket import ask

#: Repeated only if the machine was late: see `conftest.py`.
REAL_TIME = pytest.mark.flaky(reruns=3, only_rerun="MachineLate")
ON_CIRCLE = {"point": (1.0, 0.0, math.pi / 2)}
CLIENT = Path(__file__).parents[2] / "docs" / "examples" / "client.py"


@REAL_TIME
@pytest.mark.parametrize("daemon", BOARDS, indirect=True)
def test_one_script_drives_the_simulator_and_the_daemon(daemon: Any) -> None:
    simulated = circle(Car("sim", **ON_CIRCLE), 5.0)
    driven = circle(Car(str(daemon.socket)), 5.0)
    for errors in (simulated, driven):
        assert len(errors) > 120
        assert max(errors) < 0.08


@REAL_TIME
@pytest.mark.parametrize("path", ["socket", "token"])
def test_the_client_of_the_documentation_drives(daemon: Any, path: str) -> None:
    program = [sys.executable, str(CLIENT), str(getattr(daemon, path)), "6"]
    done = subprocess.run(program, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    (state,) = [line for line in lines if "setpoint" in line]
    assert state["mode"] == "driving" and state["speed_m_s"] > 0.2, done.stdout
    assert state["setpoint"]["age_s"] < 0.2, done.stdout


def test_the_client_of_the_documentation_ends_with_one_message_on_an_error(tmp_path: Path) -> None:
    program = [sys.executable, str(CLIENT), str(tmp_path / "nowhere")]
    done = subprocess.run(program, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith("client.py: ") and done.stderr.count("\n") == 1, done.stderr


@REAL_TIME
def test_actuation_and_trajectories_pass_the_socket(daemon: Any) -> None:
    car = Car(str(daemon.socket))
    with car.drive() as drive:
        for state in drive:
            drive.actuate(0.3, 0.4)
            if state.drive_time_s > 1.2:
                break
        assert abs(state.steering_rad - 0.3) < 1e-6
        assert state.setpoint_age_s < 0.2 and state.sequence is not None
        until = state.t_s + 1.0
        for state in drive:
            (x, y), yaw = state.point_m, state.yaw_rad
            vx, vy = 0.4 * math.cos(yaw), 0.4 * math.sin(yaw)
            drive.trajectory(
                [(state.t_s + s, x + vx * s, y + vy * s, vx, vy) for s in (0.0, 0.3, 0.6)]
            )
            if state.t_s > until:
                break
        assert state.speed_m_s > 0.2
    assert drive.state is not None and not drive.state.driving


@REAL_TIME
def test_an_error_a_rejection_and_ctrl_c_stop_the_car_at_the_socket(daemon: Any) -> None:
    car = Car(str(daemon.socket))
    with pytest.raises(Rejected) as rejected, car.drive() as drive:
        for _ in drive:
            # Beyond any car.
            drive.actuate(0.1, 1_000.0)
    assert rejected.value.word == "out-of-range"
    wait_until_still(car)
    script = Path(__file__).with_name("circle.py")
    program = subprocess.Popen(
        [sys.executable, str(script), str(daemon.socket)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        stderr=subprocess.DEVNULL,
        # A shell starts what runs in the background without it.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    deadline = time.monotonic() + 20
    while car.state.speed_m_s < 0.2 or car.state.mode != "driving":
        assert time.monotonic() < deadline and program.poll() is None
    program.send_signal(signal.SIGINT)
    assert program.wait(15) != 0
    wait_until_still(car)
    # A program that is killed ends the drive with its connection.
    program = subprocess.Popen(
        [sys.executable, str(script), str(daemon.socket)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    deadline = time.monotonic() + 20
    while car.state.mode != "driving":
        assert time.monotonic() < deadline and program.poll() is None
    program.kill()
    program.wait()
    wait_until_still(car)
    assert car.state.reason in ("operator-gone", "setpoint-stale")


@REAL_TIME
def test_a_second_program_does_not_disturb_the_first(daemon: Any) -> None:
    refused: list[str] = []

    def second() -> None:
        with pytest.raises(ArmError) as error, Car(str(daemon.socket)).drive():
            pass
        refused.append(str(error.value))

    other = threading.Thread(target=second)
    speeds = []
    with Car(str(daemon.socket)).drive() as drive:
        for state in drive:
            drive.point_velocity(0.0, 0.4)
            if state.drive_time_s > 1.0:
                speeds.append(state.commanded_speed_m_s)
                if other.ident is None:
                    other.start()
            if state.drive_time_s > 1.8:
                break
    other.join()
    assert drive.reason == "requested", drive.state
    assert refused == ["the car is driven already: mode driving"]
    # Its standstill was not mixed in.
    assert min(speeds) > 0.3


@REAL_TIME
def test_a_cancelled_task_stops_the_car_whatever_it_waits_for(daemon: Any) -> None:
    car = Car(str(daemon.socket))

    async def drives() -> None:
        async with car.drive() as drive:
            async for _ in drive:
                drive.point_velocity(0.0, 0.3)

    async def cancelled(after: float) -> None:
        task = asyncio.create_task(drives())
        await asyncio.sleep(after)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    # While it waits for the car, while it arms, while it drives.
    for after in (0.05, 0.8, 2.0):
        asyncio.run(cancelled(after))
        assert car.state.standing


@REAL_TIME
def test_cars_that_are_forgotten_or_closed_give_their_connections_back(daemon: Any) -> None:
    path = str(daemon.socket)
    # More than the daemon takes at a time.
    for _ in range(40):
        assert Car(path).state.standing
    # A reference of the daemon's own is replaced for the drive.
    reference = {"kind": "circle", "radius_m": 1.0, "angular_velocity_rad_s": 0.5}
    connection = Connection(path)
    ask(connection, "set-reference", 10.0, reference=reference)
    with pytest.raises(ValueError, match="not finite"):
        connection.send("tune", point_distance_m=math.nan)
    with pytest.raises(ValueError, match="velocity"):
        connection.send("setpoint", velocity=[0.0, 0.0])
    assert ask(connection, "status")["ok"]
    connection.close()
    car = Car(path)
    with pytest.raises(ConnectionError), car.drive() as drive:
        for state in drive:
            drive.point_velocity(0.0, 0.3)
            if state.drive_time_s > 0.3:
                car.close()
                car.close()
    wait_until_still(car)


FORKS = """
import os, sys, time
from singletrack import Car
with Car(sys.argv[1]).drive() as drive:
    child = 0
    for state in drive:
        drive.point_velocity(0.0, 0.3)
        if state.drive_time_s > 0.3 and not child:
            child = os.fork()
            if not child:
                # Leaves the block too.
                sys.exit(3)
        if state.drive_time_s > 1.0:
            break
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 3
    assert drive.reason is None, drive.reason
"""


@REAL_TIME
def test_a_forked_child_that_exits_leaves_the_drive_of_its_parent_alone(daemon: Any) -> None:
    car = Car(str(daemon.socket))
    program = subprocess.run(
        [sys.executable, "-P", "-c", FORKS, str(daemon.socket)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        timeout=30,
    )
    assert program.returncode == 0
    wait_until_still(car)


@REAL_TIME
def test_a_daemon_that_dies_ends_the_drive_with_an_error(daemon: Any) -> None:
    car = Car(str(daemon.socket))
    with pytest.raises(ConnectionError), car.drive() as drive:
        for state in drive:
            drive.point_velocity(0.0, 0.3)
            if state.drive_time_s > 0.3:
                daemon.daemon.kill()
    with pytest.raises(ConnectionError, match="start singletrackd"):
        assert car.state


def wait_until_still(car: Car) -> None:
    deadline = time.monotonic() + 10
    while car.state.mode not in ("ready", "idle"):
        assert time.monotonic() < deadline, car.state
