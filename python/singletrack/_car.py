"""One car, simulated or real."""

from __future__ import annotations

import math
import os
import threading
from dataclasses import asdict
from typing import Any

from ._closing import Closing
from ._drive import Backend, Drive
from ._errors import ArmError, Rejected, SingletrackError
from ._simulator import Simulator
from ._socket import SocketCar
from ._state import State, refuse_driven

#: Virtual time until a simulated car is ready: bootloader, ESC and estimator take some seconds.
_READY_TICKS = 1_500
#: Time in which a simulated car comes to rest, in ticks.
_REST_TICKS = 1_000
#: Modes of a car that drives, or will.
_UNDERWAY = ("ready", "arming", "driving", "slowing")


class SimulatedCar(Backend):
    """A backend in virtual time: a tick is run when its state is asked for."""

    def __init__(self, simulator: Simulator) -> None:
        super().__init__()
        self.simulator = simulator
        self._native = simulator._native
        # Whether this has armed the car.
        self._armed = False

    def begin(self, timeout: float, abandoned: threading.Event) -> State:
        simulator = self.simulator
        self._armed = False
        state = simulator.state
        refuse_driven(state)
        if not self._native.is_external:
            simulator.set_reference({"kind": "external"})
        for _ in range(min(_READY_TICKS, max(1, round(timeout * 100)))):
            if abandoned.is_set():
                break
            if not self._armed and state.mode == "ready":
                self._armed = True
                simulator.arm()
            # Standstill is a set-point too; without one the car would not be armed.
            self._native.setpoint({"velocity_m_s": (0.0, 0.0)})
            state = simulator.step()
            if state.driving:
                return state
        raise ArmError(f"the car did not start: mode {state.mode}, because of {state.reason}")

    def next_state(self) -> State:
        return self.simulator.step()

    def setpoint(self, keys: dict[str, Any]) -> None:
        try:
            self._native.setpoint(keys)
        except ValueError as error:
            raise Rejected(*error.args) from error

    def disarm(self) -> None:
        if self._armed and self.simulator.state.mode in _UNDERWAY:
            self.simulator.disarm()

    def abandon(self) -> None:
        self.disarm()

    def end(self) -> State | None:
        state = self.simulator.state
        if not self._armed:
            # Somebody else drives it, or nobody.
            return state
        if state.mode in _UNDERWAY:
            # Requests are taken with the next tick.
            state = self.simulator.step()
        self._armed = False
        for _ in range(_REST_TICKS):
            if state.standing:
                break
            state = self.simulator.step()
        return state

    def stop(self) -> None:
        self.simulator.stop()
        self.simulator.step()

    def tune(self, keys: dict[str, Any]) -> None:
        try:
            self._native.tune(**keys)
        except ValueError as error:
            raise SingletrackError(f"can't tune: {error}") from error

    def state(self) -> State:
        return self.simulator.state

    def status(self) -> dict[str, Any]:
        return {"state": asdict(self.simulator.state), "truth": self.simulator.truth()}

    def close(self) -> None:
        self.simulator.close()


class Car(Closing):
    """A car: ``"sim"``, a :class:`Simulator`, or the control socket of a daemon.

    Args:
        target: ``"sim"``, a simulator, or the path of ``socket.path``.
        options: Arguments of :class:`Simulator` for ``"sim"``. For a socket, ``uncalibrated``
            arms a car whose commissioning is not complete, as the option of `singletrack arm`.
    """

    def __init__(self, target: str | os.PathLike[str] | Simulator = "sim", **options: Any) -> None:
        self._backend: Backend
        if isinstance(target, Simulator):
            if options:
                raise TypeError(f"the simulator has its options already: {', '.join(options)}")
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

    def tune(
        self,
        *,
        gain: float | tuple[float, float] | None = None,
        point_distance: float | None = None,
    ) -> None:
        """Changes gains or p, also in a drive, within the bounds of ``[tuning]``.

        The values hold until they are changed again, or the daemon is started again. A simulated
        car takes them with its next tick.

        Args:
            gain: Gain of the position loop in 1/s, for both axes or one for each.
            point_distance: The distance p in m; it changes by 0.05 m/s.

        Raises:
            SingletrackError: The daemon refuses the values; the text has the bounds.
        """
        keys: dict[str, Any] = {}
        if gain is not None:
            x, y = gain if isinstance(gain, tuple) else (gain, gain)
            keys["gain_per_s"] = [float(x), float(y)]
        if point_distance is not None:
            keys["point_distance_m"] = float(point_distance)
        self._backend.tune(keys)

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
        if not 0 <= timeout < math.inf:
            raise ValueError(f"timeout is {timeout}: give seconds")
        return Drive(self._backend, timeout)

    def close(self) -> None:
        """Closes the connections; completes the record of a simulated car."""
        self._backend.close()
