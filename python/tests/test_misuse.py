"""Programs that are wrong, cancelled, or two: the car stops, and the error names the reason."""

from __future__ import annotations

import asyncio
import math
import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable
from types import FrameType
from typing import Any

import gymnasium
import numpy as np
import pytest

import singletrack
from singletrack import ArmError, Car, Drive, Rejected, Simulator, State, stability


def test_a_drive_is_a_block() -> None:
    car = Car("sim")
    drive = car.drive()
    with pytest.raises(RuntimeError, match="has not begun"):
        next(drive)
    with pytest.raises(RuntimeError, match="inside of the block"):
        drive.point_velocity(0.1, 0.0)
    # The same block can be entered again, but not twice at a time.
    for _ in range(2):
        with drive:
            assert next(drive).driving
            with pytest.raises(RuntimeError, match="driven already"), car.drive():
                pass
            drive.point_velocity(0.1, 0.0)
        assert list(drive) == [] and drive.reason == "requested"
    with pytest.raises(RuntimeError, match="inside of the block"):
        drive.actuate(0.1, 0.1)


def test_a_car_that_is_driven_otherwise_is_refused_and_left_alone() -> None:
    circle = {"kind": "circle", "radius_m": 1.0, "angular_velocity_rad_s": 0.5}
    simulator = Simulator(reference=circle, point=(1.0, 0.0, math.pi / 2))
    for _ in range(1_000):
        if simulator.mode == "ready":
            simulator.arm()
        if simulator.step().mode == "driving":
            break
    with pytest.raises(ArmError, match="driven already"), Car(simulator).drive():
        pass
    assert simulator.step(100).mode == "driving" and simulator.state.speed_m_s > 0.2
    # Another car of the same simulator is refused, and the drive of the first goes on.
    simulator = Simulator()
    with Car(simulator).drive() as drive:
        for state in drive:
            drive.point_velocity(0.3, 0.0)
            if state.drive_time_s > 0.3:
                break
        with pytest.raises(ArmError, match="driven already"), Car(simulator).drive():
            pass
        drive.point_velocity(0.3, 0.0)
        assert next(drive).driving


def test_a_drive_that_has_ended_says_so_to_what_goes_on() -> None:
    simulator = Simulator()
    with Car(simulator).drive() as drive:
        for state in drive:
            drive.point_velocity(0.3, 0.0)
            if state.drive_time_s > 0.5:
                simulator.fault("imu", "silent")
        with pytest.raises(singletrack.SingletrackError, match="has ended: imu-silent"):
            drive.point_velocity(0.3, 0.0)


@pytest.mark.parametrize(
    ("send", "word"),
    [
        (lambda drive, t: drive.actuate(0.1, 1_000.0), "out-of-range"),
        (lambda drive, t: drive.actuate(math.nan, 0.1), "not-finite"),
        (lambda drive, t: drive.point_velocity(0.1, 0.0, position=(1e9, 0.0)), "out-of-range"),
        (lambda drive, t: drive.trajectory([[t, 0, 0, 0, 0]]), "out-of-range"),
        (lambda drive, t: drive.trajectory([[t - 2, 0, 0, 0, 0], [t - 1, 0, 0, 0, 0]]), "old"),
        (lambda drive, t: drive.trajectory([[t + 5, 0, 0, 0, 0], [t + 6, 0, 0, 0, 0]]), "future"),
        (lambda drive, t: drive.trajectory(np.full((3, 5), np.nan)), "not-finite"),
        (lambda drive, t: drive.trajectory(np.full((3, 5), 1e300)), "out-of-range"),
    ],
)
def test_a_rejected_setpoint_has_the_daemons_word(
    send: Callable[[Drive, float], None], word: str
) -> None:
    with pytest.raises(Rejected) as rejected, Car("sim").drive() as drive:
        send(drive, next(drive).t_s)
    assert rejected.value.word == word


def test_numbers_of_numpy_are_numbers() -> None:
    with Car("sim").drive() as drive:
        for state in drive:
            drive.actuate(np.float32(0.1), np.array(0.3))
            drive.point_velocity(np.int64(0), np.float64(0.2), position=np.array([1.0, 0.0]))
            if state.drive_time_s > 0.2:
                break
        with pytest.raises(TypeError):
            drive.point_velocity(np.zeros(3), 0.0)
        with pytest.raises(ValueError, match="shape"):
            drive.trajectory(np.zeros((3, 4)))
    assert drive.reason == "requested"


def cancelled(car: Car, ticks: int) -> State:
    """The state after a task was cancelled that had driven so many ticks, or was still arming."""

    async def drives(far_enough: asyncio.Event) -> None:
        async with car.drive() as drive:
            seen = 0
            async for _ in drive:
                drive.point_velocity(0.4, 0.0)
                seen += 1
                if seen == ticks:
                    far_enough.set()

    async def main() -> None:
        far_enough = asyncio.Event()
        task = asyncio.create_task(drives(far_enough))
        if ticks == 0:
            await asyncio.sleep(0)
        else:
            await far_enough.wait()
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    asyncio.run(main())
    return car.state


@pytest.mark.parametrize("ticks", [0, 1, 30])
def test_a_task_that_is_cancelled_leaves_no_car_that_is_armed(ticks: int) -> None:
    car = Car("sim")
    assert cancelled(car, ticks).standing
    # Nothing of it goes on.
    with car.drive() as drive:
        assert next(drive).driving


def test_ctrl_c_anywhere_in_the_entry_of_a_block_leaves_no_car_that_is_armed() -> None:
    class Interrupts:
        """Interrupts at the nth event of the entry after the car was armed."""

        def __init__(self, nth: int) -> None:
            self.left = nth

        def __call__(self, frame: FrameType, event: str, argument: Any) -> Any:
            code = frame.f_code
            if code.co_name not in ("__enter__", "_enter", "begin"):
                return None
            if car._backend._armed:  # type: ignore[attr-defined]
                self.left -= 1
                if self.left == 0:
                    sys.settrace(None)
                    raise KeyboardInterrupt
            return self

    car = Car("sim")
    interrupted = 0
    for nth in range(1, 10_000):
        before = sys.gettrace()
        sys.settrace(Interrupts(nth))
        try:
            with car.drive():
                sys.settrace(before)
                break
        except KeyboardInterrupt:
            interrupted += 1
        finally:
            sys.settrace(before)
        assert car._backend.simulator.step(300).mode in ("ready", "idle")  # type: ignore[attr-defined]
    assert interrupted > 10


def test_ctrl_c_ends_a_long_simulation() -> None:
    simulator = Simulator()
    # In the background of a shell without job control, programs start with the signal ignored.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            threading.Timer(0.2, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
            # It ends some time even if nothing interrupts it.
            simulator.step(2_000_000)
    finally:
        signal.signal(signal.SIGINT, before)
    assert simulator.now < 10_000.0


def test_a_copy_of_the_process_can_go_on() -> None:
    simulator = Simulator()
    simulator.step(10)
    child = os.fork()
    if child == 0:
        simulator.step(10)
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
    assert simulator.step(10).tick == 19


def test_a_state_can_be_pickled_and_a_car_not() -> None:
    car = Car("sim")
    assert pickle.loads(pickle.dumps(car.state)).tick == car.state.tick
    with pytest.raises(TypeError, match="pickle"):
        pickle.dumps(car)


def test_closing_twice_is_harmless() -> None:
    car = Car("sim")
    car.close()
    car.close()


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: Simulator(start=(math.nan, 0.0, 0.0)), "place"),
        (lambda: Simulator(point=(1e300, 0.0, 0.0)), "place"),
        (lambda: Simulator().place(math.inf, 0.0, 0.0), "place"),
        (lambda: Simulator().fault("line_drop", 5.0), "between 0 and 1"),
        (lambda: Simulator().fault("camera_jump_m", (math.nan, 0.0, 0.0)), "lengths"),
        (lambda: Simulator().fault("imu", "silence"), '"silent"'),
        (lambda: Car("sim").drive(timeout=math.nan), "timeout"),
        (lambda: Simulator(configuration=[1, 2]), "dictionary"),  # type: ignore[arg-type]
        (lambda: Car(Simulator(), seed=3), "seed"),
        (lambda: stability.critical_speed((0.1, -0.1)), "in order"),
        (lambda: gymnasium.make("Singletrack-v0", randomise="other_cars"), "other-cars"),
        (lambda: gymnasium.make("Singletrack-v0", lost=math.nan), "lost"),
        (lambda: gymnasium.make("Singletrack-v0", preview=(math.nan,)), "preview"),
        (lambda: gymnasium.make("Singletrack-v0", start_error=(-1.0, 0.0)), "start_error"),
        (lambda: gymnasium.make_vec("Singletrack-v0", num_envs=0), "num_envs"),
        (lambda: vector().step(np.zeros((3, 3))), "shape"),
        (lambda: vector().reset(options={"reset_mask": [True]}), "mask"),
    ],
)
def test_a_mistake_is_named(make: Callable[[], Any], word: str) -> None:
    with pytest.raises((ValueError, TypeError), match=word):
        make()


def vector() -> Any:
    envs = gymnasium.make_vec("Singletrack-v0", num_envs=3)
    envs.reset(seed=np.int64(1))  # type: ignore[arg-type]
    return envs
