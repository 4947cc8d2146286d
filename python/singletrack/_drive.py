"""A drive by set-points of a program."""

from __future__ import annotations

import asyncio
import math
import threading
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Iterator, Sequence
from types import TracebackType
from typing import Any, SupportsFloat

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._errors import ArmError, Rejected, SingletrackError
from ._state import State


class Backend(ABC):
    """What a drive needs of a car."""

    def __init__(self) -> None:
        #: Held for the time of a drive.
        self.claim = threading.Lock()

    @abstractmethod
    def begin(self, timeout: float, abandoned: threading.Event) -> State:
        """Waits until the car can drive, and arms it; the state of a driving tick.

        After an error or an interrupt, `disarm` and `end` stop the car if this has armed it.
        """

    @abstractmethod
    def next_state(self) -> State:
        """The state of the next tick."""

    @abstractmethod
    def setpoint(self, keys: dict[str, Any]) -> None:
        """Sends a set-point with the keys of the control socket."""

    @abstractmethod
    def disarm(self) -> None:
        """Begins to stop the car; any thread may call it at any time."""

    @abstractmethod
    def abandon(self) -> None:
        """Begins to stop the car, without a lock or a wait; any thread may call it at any time."""

    @abstractmethod
    def end(self) -> State | None:
        """Stops the car and waits until it stands; the last state."""

    @abstractmethod
    def stop(self) -> None:
        """An emergency stop."""

    @abstractmethod
    def tune(self, keys: dict[str, Any]) -> None:
        """Tunes the pilot with the keys of the control socket."""

    @abstractmethod
    def state(self) -> State:
        """The newest state."""

    @abstractmethod
    def status(self) -> dict[str, Any]:
        """Further information."""

    @abstractmethod
    def close(self) -> None:
        """Gives up what is open."""


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
        self._inside = self._ended = False
        # A program that is cancelled may leave the block while a thread waits for a tick.
        self._waiting = threading.Lock()
        #: Why the drive has ended; ``None`` while the car drives.
        self.reason: str | None = None
        #: The newest state.
        self.state: State | None = None

    def __enter__(self) -> Drive:
        return self._enter(threading.Event())

    def _enter(self, abandoned: threading.Event) -> Drive:
        claimed = False
        # Ctrl-C may come anywhere, also after the car was armed.
        try:
            claimed = self._backend.claim.acquire(blocking=False)
            if not claimed:
                raise RuntimeError("this car is driven already, by another block of this program")
            self._first = self.state = self._backend.begin(self._timeout, abandoned)
            self._inside, self._ended, self.reason = True, False, None
            if abandoned.is_set():
                raise ArmError("the program does not wait any more")
        except BaseException:
            if claimed:
                self._leave()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._leave()

    def __del__(self) -> None:
        # An interrupt between the entry and the block leaves a drive that nothing ends.
        if self._inside:
            self._inside = False
            self._backend.abandon()
            self._backend.claim.release()

    def _leave(self) -> None:
        self._ended = True
        try:
            self._backend.disarm()
            with self._waiting:
                last = self._backend.end()
            if last is not None:
                self.state = last
                self.reason = self.reason or last.reason
        finally:
            self._inside = False
            self._backend.claim.release()

    def __iter__(self) -> Iterator[State]:
        return self

    def __next__(self) -> State:
        if not (self._inside or self._ended):
            raise RuntimeError("the drive has not begun: use `with car.drive() as drive`")
        with self._waiting:
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
        abandoned = threading.Event()
        entering = asyncio.ensure_future(asyncio.to_thread(self._enter, abandoned))
        try:
            return await asyncio.shield(entering)
        except asyncio.CancelledError:
            # The thread goes on: it must not leave a car that is armed.
            abandoned.set()
            await asyncio.wait([entering])
            if entering.exception() is None:
                await self.__aexit__(None, None, None)
            raise

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
        self,
        vx: SupportsFloat,
        vy: SupportsFloat,
        *,
        position: Sequence[SupportsFloat] | NDArray[Any] | None = None,
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
        steering_rad: SupportsFloat | None = None,
        speed_m_s: SupportsFloat | None = None,
        *,
        steering_rate_rad_s: SupportsFloat | None = None,
        acceleration_m_s2: SupportsFloat | None = None,
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
                scale of :attr:`State.t_s` in s, position (m) and velocity (m/s) of P. A new
                trajectory replaces the old one without a jump. It must be renewed before
                ``reference.setpoint_timeout_ms`` has passed.
        """
        rows = np.asarray(points, dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] != 5:
            raise ValueError(f"a trajectory has the shape (n, 5), not {rows.shape}")
        state = self._newest()
        if not np.isfinite(rows).all():
            raise Rejected("a value is not finite", "not-finite")
        times = rows[:, 0] - state.t_s
        if (np.abs(times) > 1e6).any():
            # Beyond the range of the clock.
            raise Rejected("a time of the trajectory is beyond all drives", "out-of-range")
        keys = [
            {
                "time_ns": max(0, state.time_ns + round(t * 1e9)),
                "position_m": [x, y],
                "velocity_m_s": [vx, vy],
            }
            for t, (_, x, y, vx, vy) in zip(times.tolist(), rows.tolist(), strict=True)
        ]
        self._send({"trajectory": keys})

    def _newest(self) -> State:
        """The newest state of a drive that is underway."""
        if not self._inside or self.state is None:
            raise RuntimeError("set-points belong inside of the block `with car.drive() as drive`")
        if self._ended:
            raise SingletrackError(f"the drive has ended: {self.reason}")
        return self.state

    def _send(self, keys: dict[str, Any]) -> None:
        self._newest()
        self._sequence += 1
        self._backend.setpoint({**keys, "sequence": self._sequence})


def _finite(*values: SupportsFloat) -> list[float]:
    numbers = [float(value) for value in values]
    if not all(map(math.isfinite, numbers)):
        raise Rejected(f"a value is not finite: {numbers}", "not-finite")
    return numbers
