"""One car, simulated or real."""

from __future__ import annotations

import asyncio
import math
import os
from collections.abc import AsyncIterator, Iterator, Sequence
from types import TracebackType
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from ._errors import ArmError, Rejected
from ._simulator import Simulator
from ._socket import SocketCar
from ._state import State

#: Virtual time until a simulated car is ready: bootloader, ESC and estimator take some seconds.
_READY_TICKS = 1_500
#: Time in which a simulated car comes to rest, in ticks.
_REST_TICKS = 1_000


class Backend(Protocol):
    """What a drive needs of a car."""

    def begin(self, timeout: float) -> State:
        """Waits until the car can drive, and arms it; the state of a driving tick."""

    def next_state(self) -> State:
        """The state of the next tick."""

    def setpoint(self, keys: dict[str, Any]) -> None:
        """Sends a set-point with the keys of the control socket."""

    def end(self) -> State | None:
        """Stops the car and waits until it stands; the last state."""

    def stop(self) -> None:
        """An emergency stop."""

    def state(self) -> State:
        """The newest state."""

    def status(self) -> dict[str, Any]:
        """Further information."""

    def close(self) -> None:
        """Gives up what is open."""


class SimulatedCar:
    """A backend in virtual time: a tick is run when its state is asked for."""

    def __init__(self, simulator: Simulator) -> None:
        self.simulator = simulator
        self._native = simulator._native

    def begin(self, timeout: float) -> State:
        simulator = self.simulator
        if not self._native.is_external:
            simulator.set_reference({"kind": "external"})
        armed = False
        state = simulator.state
        for _ in range(min(_READY_TICKS, max(1, round(timeout * 100)))):
            if not armed and state.mode == "ready":
                simulator.arm()
                armed = True
            # Standstill is a set-point too; without one the car would not be armed.
            self._native.point_velocity((0.0, 0.0), None, None)
            state = simulator.step()
            if state.driving:
                return state
        raise ArmError(f"the car did not start: mode {state.mode}, because of {state.reason}")

    def next_state(self) -> State:
        return self.simulator.step()

    def setpoint(self, keys: dict[str, Any]) -> None:
        sequence = keys.get("sequence")
        try:
            if "trajectory" in keys:
                rows = [
                    (point["time_ns"], [*point["position_m"], *point["velocity_m_s"]])
                    for point in keys["trajectory"]
                ]
                self._native.trajectory(rows, sequence)
            elif "velocity_m_s" in keys:
                self._native.point_velocity(
                    keys["velocity_m_s"], keys.get("position_m"), sequence
                )
            else:
                self._native.actuate(
                    keys.get("steering_rad"),
                    keys.get("steering_rate_rad_s"),
                    keys.get("speed_m_s"),
                    keys.get("acceleration_m_s2"),
                    sequence,
                )
        except ValueError as error:
            raise Rejected(str(error), "out-of-range") from error

    def end(self) -> State | None:
        state = self.simulator.state
        if state.driving:
            self.simulator.disarm()
            # The requests are taken with the next tick.
            state = self.simulator.step()
        for _ in range(_REST_TICKS):
            if state.mode in ("idle", "ready", "fault", "disconnected"):
                break
            state = self.simulator.step()
        return state

    def stop(self) -> None:
        self.simulator.stop()
        self.simulator.step()

    def state(self) -> State:
        return self.simulator.state

    def status(self) -> dict[str, Any]:
        state = self.simulator.state
        return {"mode": state.mode, "reason": state.reason, "truth": self.simulator.truth()}

    def close(self) -> None:
        self.simulator.close()


class Car:
    """A car: ``"sim"``, a :class:`Simulator`, or the control socket of a daemon.

    Args:
        target: ``"sim"``, a simulator, or the path of ``socket.path``.
        options: Arguments of :class:`Simulator` for ``"sim"``. For a socket, ``uncalibrated``
            arms a car whose commissioning is not complete, as the option of `singletrack arm`.
    """

    def __init__(self, target: str | os.PathLike[str] | Simulator = "sim", **options: Any) -> None:
        self._backend: Backend
        if isinstance(target, Simulator):
            self._backend = SimulatedCar(target)
        elif target == "sim":
            self._backend = SimulatedCar(Simulator(**options))
        else:
            self._backend = SocketCar(os.fspath(target), **options)

    @property
    def simulator(self) -> Simulator | None:
        """The simulator, if the car is simulated."""
        backend = self._backend
        return backend.simulator if isinstance(backend, SimulatedCar) else None

    @property
    def state(self) -> State:
        """The newest state."""
        return self._backend.state()

    def status(self) -> dict[str, Any]:
        """The daemon's answer to `status`; less of a simulated car."""
        return self._backend.status()

    def stop(self) -> None:
        """An emergency stop: the motor stays in neutral until the board is reset."""
        self._backend.stop()

    def drive(self, timeout: float = 15.0) -> Drive:
        """A drive by set-points of this program.

        ``with car.drive() as drive`` arms the car, with this program as the dead-man switch.
        Leaving the block stops the car, also by an exception or Ctrl-C, and waits until it
        stands. The car also stops when this program ends, or sends no set-point for
        ``reference.setpoint_timeout_ms``. ``async with`` and ``async for`` do the same.

        The reference of the daemon becomes ``external``, unless it is already.

        Args:
            timeout: How long to wait until the car can be armed, in s.
        """
        return Drive(self._backend, timeout)

    def close(self) -> None:
        """Closes the connections; completes the record of a simulated car."""
        self._backend.close()

    def __enter__(self) -> Car:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


class Drive:
    """A drive; see :meth:`Car.drive`. Iterating gives the state of every tick.

    The iteration ends when the car stops by itself; :attr:`reason` then says why. A program
    that is slower than the ticks misses states: the newest one is given.
    """

    def __init__(self, backend: Backend, timeout: float) -> None:
        self._backend = backend
        self._timeout = timeout
        self._first: State | None = None
        self._sequence = 0
        self._ended = False
        #: Why the drive has ended; ``None`` while the car drives.
        self.reason: str | None = None
        #: The newest state.
        self.state: State | None = None

    def __enter__(self) -> Drive:
        self._first = self.state = self._backend.begin(self._timeout)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        last = self._backend.end()
        if last is not None:
            self.state = last
            self.reason = self.reason or last.reason
        self._ended = True

    def __iter__(self) -> Iterator[State]:
        return self

    def __next__(self) -> State:
        if self._ended:
            raise StopIteration
        if self._first is not None:
            state, self._first = self._first, None
        else:
            state = self._backend.next_state()
        self.state = state
        if not state.driving:
            self._ended = True
            self.reason = state.reason
            raise StopIteration
        return state

    async def __aenter__(self) -> Drive:
        return await asyncio.to_thread(self.__enter__)

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        # The car is stopped even if the task is cancelled.
        await asyncio.shield(asyncio.to_thread(self.__exit__, kind, error, trace))

    def __aiter__(self) -> AsyncIterator[State]:
        return self

    async def __anext__(self) -> State:
        state = await asyncio.to_thread(next, self, None)
        if state is None:
            raise StopAsyncIteration
        return state

    def point_velocity(
        self, vx: float, vy: float, *, position: Sequence[float] | None = None
    ) -> None:
        """The velocity of P in the world, in m/s; the law steers.

        With a ``position`` (m), the outer loop corrects the distance to it too.
        """
        keys: dict[str, Any] = {"velocity_m_s": _finite(vx, vy)}
        if position is not None:
            x, y = position
            keys["position_m"] = _finite(x, y)
        self._send(keys)

    def actuate(
        self,
        steering_rad: float | None = None,
        speed_m_s: float | None = None,
        *,
        steering_rate_rad_s: float | None = None,
        acceleration_m_s2: float | None = None,
    ) -> None:
        """Steering angle (or rate) and speed (or acceleration), past the law.

        The limits of the configuration apply: speed, acceleration, steering, steering rate and
        lateral acceleration.
        """
        given = {
            "steering_rad": steering_rad,
            "steering_rate_rad_s": steering_rate_rad_s,
            "speed_m_s": speed_m_s,
            "acceleration_m_s2": acceleration_m_s2,
        }
        if (steering_rad is None) == (steering_rate_rad_s is None):
            raise TypeError("give steering_rad or steering_rate_rad_s")
        if (speed_m_s is None) == (acceleration_m_s2 is None):
            raise TypeError("give speed_m_s or acceleration_m_s2")
        self._send({key: _finite(value)[0] for key, value in given.items() if value is not None})

    def trajectory(self, points: ArrayLike) -> None:
        """Timed points, which the outer loop follows.

        Args:
            points: Shape ``(n, 5)``, 2 to 100 rows of ``t, x, y, vx, vy``: the time on the
                scale of :attr:`State.t` in s, position (m) and velocity (m/s) of P. A new
                trajectory replaces the old one without a jump. It must be renewed before
                ``reference.setpoint_timeout_ms`` has passed.
        """
        rows = np.asarray(points, dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] != 5:
            raise ValueError(f"a trajectory has the shape (n, 5), not {rows.shape}")
        state = self.state
        if state is None:
            raise RuntimeError("the drive has not begun")
        if not np.isfinite(rows).all():
            raise Rejected("a value is not finite", "not-finite")
        keys = [
            {
                "time_ns": state.time_ns + round((t - state.t) * 1e9),
                "position_m": [x, y],
                "velocity_m_s": [vx, vy],
            }
            for t, x, y, vx, vy in rows.tolist()
        ]
        self._send({"trajectory": keys})

    def _send(self, keys: dict[str, Any]) -> None:
        self._sequence += 1
        self._backend.setpoint({**keys, "sequence": self._sequence})


def _finite(*values: float) -> list[float]:
    numbers = [float(value) for value in values]
    if not all(map(math.isfinite, numbers)):
        raise Rejected(f"a value is not finite: {numbers}", "not-finite")
    return numbers
