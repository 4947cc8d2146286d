"""A car behind the daemon's control socket. See docs/control-socket.md."""

from __future__ import annotations

import threading
import time
import warnings
from collections.abc import Callable
from typing import Any

from ._drive import Backend
from ._errors import ArmError, Rejected, SingletrackError
from ._native import Connection
from ._state import State, refuse_driven, state

#: Interval of the renewals that keep the drive alive, in s.
_HOLD = 0.1
#: Interval of the standstill set-points before the first of the program, in s.
_STANDSTILL = 0.05
#: The longest silence of the daemon, in s.
_SILENCE = 2.0


def ask(
    connection: Connection, command: str, timeout: float = 5.0, **keys: Any
) -> dict[str, Any]:
    """The answer to a command."""
    connection.send(command, **keys)
    deadline = time.monotonic() + timeout
    while True:
        answer = connection.take(max(0.0, deadline - time.monotonic()))
        if answer is None:
            raise TimeoutError(f"no answer to {command}")
        if "ok" in answer and "rejected" not in answer:
            if not answer["ok"]:
                raise SingletrackError(answer.get("error", "refused"))
            return answer


class SocketCar(Backend):
    """A backend that is a client of the daemon.

    Three connections: one arms and holds the drive, one sends set-points, one reads states.
    """

    def __init__(self, path: str, *, uncalibrated: bool = False) -> None:
        super().__init__()
        self._path = path
        self._uncalibrated = uncalibrated
        self._control: Connection | None = None
        self._setpoints: Connection | None = None
        self._states: Connection | None = None
        self._newest: State | None = None
        self._holding = threading.Event()
        self._released = threading.Event()
        self._keeper: threading.Thread | None = None
        # A daemon that is not there is named at once.
        Connection(path).close()

    def status(self) -> dict[str, Any]:
        connection = Connection(self._path)
        try:
            answer: dict[str, Any] = ask(connection, "status")["status"]
            return answer
        finally:
            connection.close()

    def state(self) -> State:
        if self._states is None:
            states = Connection(self._path)
            ask(states, "watch", topics=["state"])
            self._states = states
        try:
            return self._receive(self._states)
        except ConnectionError:
            # The daemon may come back.
            self._states = None
            raise

    def next_state(self) -> State:
        if self._keeper is not None and not self._keeper.is_alive() and self._holding.is_set():
            raise ConnectionError("the connection that holds the drive is lost")
        if self._states is None:
            raise ConnectionError("the car is closed")
        self._raise_rejected()
        return self._receive(self._states)

    def _receive(self, states: Connection) -> State:
        """The newest state that has not been given yet; waits for one."""
        newest: dict[str, Any] | None = None
        wait = _SILENCE
        while (line := states.take(wait)) is not None:
            if line.get("topic") == "state":
                newest = line
                wait = 0.0
        if newest is None:
            raise TimeoutError(f"no state for {_SILENCE} s")
        self._newest = state(newest)
        return self._newest

    def begin(self, timeout: float, abandoned: threading.Event) -> State:
        deadline = time.monotonic() + timeout
        self._released.clear()
        try:
            # Set-points are for a car that nobody drives.
            self._await(lambda now: now.standing, deadline, abandoned)
            self._setpoints = Connection(self._path)
            self._make_external()
            while True:
                # Standstill is a set-point too; without one the car is not ready.
                self._await(lambda now: now.mode == "ready", deadline, abandoned)
                try:
                    return self._arm()
                except ArmError as error:
                    # The mode has changed meanwhile, for example because the board restarts.
                    if error.code != "not-ready" or time.monotonic() > deadline:
                        raise
                    self._let_go()
        except BaseException:
            self.disarm()
            self.end()
            raise

    def _await(
        self, reached: Callable[[State], bool], deadline: float, abandoned: threading.Event
    ) -> None:
        while not reached(now := self.state()):
            refuse_driven(now)
            if abandoned.is_set() or time.monotonic() > deadline:
                raise ArmError(f"the car is not ready: mode {now.mode}, because of {now.reason}")
            self._standstill()

    def _arm(self) -> State:
        control = self._control = Connection(self._path)
        self._holding.set()
        self._standstill()
        more = {"uncalibrated": True} if self._uncalibrated else {}
        control.send("arm", attendance="hold", **more)
        self._keeper = threading.Thread(
            target=self._keep, args=(control,), daemon=True, name="singletrack-hold"
        )
        self._keeper.start()
        self._await_armed(control)
        deadline = time.monotonic() + _SILENCE
        while not (now := self.state()).driving:
            if time.monotonic() > deadline:
                raise ArmError(f"the drive has ended at once: mode {now.mode}, {now.reason}")
        return now

    def _let_go(self) -> None:
        """Ends the renewals, and closes what holds the drive."""
        self._holding.clear()
        if self._control is not None:
            # The daemon stops the car, if it drives.
            self._control.close()
            self._control = None
        if self._keeper is not None:
            self._keeper.join(1.0)
            self._keeper = None

    def _make_external(self) -> None:
        """Makes the reference external, unless it is."""
        assert self._setpoints is not None
        self._setpoints.send("setpoint", velocity_m_s=[0.0, 0.0])
        self._setpoints.send("status")
        # A set-point that is obeyed has no answer.
        answer = self._setpoints.take(5.0)
        if answer is None:
            raise TimeoutError("no answer to setpoint")
        if "rejected" in answer:
            if answer["code"] != "not-external":
                raise Rejected(answer["error"], answer["code"])
            self._setpoints.take(5.0)
            ask(self._setpoints, "set-reference", 10.0, reference={"kind": "external"})

    def _await_armed(self, control: Connection) -> None:
        deadline = time.monotonic() + 15.0
        while True:
            answer = control.take(max(0.0, deadline - time.monotonic()))
            if answer is None:
                raise ArmError("no answer to arm")
            if answer.get("ok") is True:
                for warning in answer.get("warnings", ()):
                    warnings.warn(warning, RuntimeWarning, stacklevel=5)
                return
            if "error" in answer:
                raise ArmError(answer["error"], answer.get("code"))
            if "ended" in answer:
                raise ArmError(f"the drive has ended: {answer['ended'].get('reason')}")

    def _standstill(self) -> None:
        if self._setpoints is not None and not self._released.is_set():
            self._setpoints.send("setpoint", velocity_m_s=[0.0, 0.0])

    def _keep(self, control: Connection) -> None:
        """Renews the drive; and stands still until the program's first set-point.

        A program that hangs sends no set-points, which stops the car, whatever this does.
        """
        last_hold = 0.0
        try:
            while self._holding.is_set():
                now = time.monotonic()
                if now - last_hold >= _HOLD:
                    control.send("hold")
                    last_hold = now
                self._standstill()
                time.sleep(_STANDSTILL)
        except OSError:
            return

    def setpoint(self, keys: dict[str, Any]) -> None:
        if self._setpoints is None:
            raise ConnectionError("the car is closed")
        self._released.set()
        self._raise_rejected()
        self._setpoints.send("setpoint", time_ns=time.monotonic_ns(), **keys)

    def _raise_rejected(self) -> None:
        """Raises the first set-point that was rejected since the last call."""
        if self._setpoints is None:
            return
        while (answer := self._setpoints.take(0.0)) is not None:
            if "rejected" in answer:
                # The reference may have been changed since: that is another end of the drive.
                raise Rejected(answer["error"], answer["code"])

    def disarm(self) -> None:
        control = self._control
        try:
            if control is not None:
                control.send("disarm")
        except OSError:
            # The daemon has gone, or the connection; either stops the car.
            pass

    def abandon(self) -> None:
        self._holding.clear()
        if self._control is not None:
            # The daemon stops the car.
            self._control.close()

    def end(self) -> State | None:
        try:
            deadline = time.monotonic() + 15.0
            while self._control is not None and time.monotonic() < deadline:
                if self.state().standing:
                    break
        except (OSError, SingletrackError):
            pass
        finally:
            self._shut()
        return self._newest

    def stop(self) -> None:
        connection = Connection(self._path)
        try:
            ask(connection, "stop")
        finally:
            connection.close()

    def tune(self, keys: dict[str, Any]) -> None:
        connection = Connection(self._path)
        try:
            ask(connection, "tune", **keys)
        finally:
            connection.close()

    def close(self) -> None:
        self._shut()

    def _shut(self) -> None:
        self._let_go()
        for connection in (self._setpoints, self._states):
            if connection is not None:
                connection.close()
        self._setpoints = self._states = None
