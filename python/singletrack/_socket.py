"""The daemon's control socket: JSON lines. See docs/control-socket.md."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections import deque
from typing import Any

from ._errors import ArmError, Rejected, SingletrackError
from ._state import State, state

_VERSION = 2
#: Interval of the renewals that keep the drive alive, in s.
_HOLD = 0.1
#: Interval of the standstill set-points before the first of the program, in s.
_STANDSTILL = 0.05
#: The longest silence of the daemon, in s.
_SILENCE = 2.0


class Connection:
    """A connection; a thread reads its lines."""

    def __init__(self, path: str) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.connect(path)
        except OSError as error:
            self._socket.close()
            raise ConnectionError(f"{path}: {error.strerror}; does singletrackd run?") from error
        self._write = threading.Lock()
        self._changed = threading.Condition()
        self._lines: deque[dict[str, Any]] = deque(maxlen=1_000)
        self._closed = False
        self._thread = threading.Thread(target=self._read, daemon=True, name="singletrack-read")
        self._thread.start()

    def send(self, command: str, **keys: Any) -> None:
        line = json.dumps({"version": _VERSION, "command": command, **keys}, allow_nan=False)
        with self._write:
            self._socket.sendall(line.encode() + b"\n")

    def take(self, timeout: float = 0.0) -> dict[str, Any] | None:
        """The oldest line that has not been taken; ``None`` after the time-out."""
        with self._changed:
            self._changed.wait_for(lambda: self._lines or self._closed, timeout)
            if self._lines:
                return self._lines.popleft()
            if self._closed:
                raise ConnectionError("the daemon has closed the connection")
            return None

    def ask(self, command: str, timeout: float = 5.0, **keys: Any) -> dict[str, Any]:
        """The answer to a command."""
        self.send(command, **keys)
        deadline = time.monotonic() + timeout
        while True:
            answer = self.take(max(0.0, deadline - time.monotonic()))
            if answer is None:
                raise TimeoutError(f"no answer to {command}")
            if "ok" in answer and "rejected" not in answer:
                if not answer["ok"]:
                    raise SingletrackError(answer.get("error", "refused"))
                return answer

    def close(self) -> None:
        try:
            self._socket.shutdown(socket.SHUT_RDWR)
        except OSError:
            pass
        self._socket.close()

    def _read(self) -> None:
        try:
            with self._socket.makefile("rb") as lines:
                for line in lines:
                    with self._changed:
                        self._lines.append(json.loads(line))
                        self._changed.notify_all()
        except (OSError, ValueError):
            pass
        with self._changed:
            self._closed = True
            self._changed.notify_all()


class SocketCar:
    """A backend that is a client of the daemon.

    Three connections: one arms and holds the drive, one sends set-points, one reads states.
    """

    def __init__(self, path: str, *, uncalibrated: bool = False) -> None:
        self._path = path
        self._uncalibrated = uncalibrated
        self._control = Connection(path)
        self._setpoints: Connection | None = None
        self._states: Connection | None = None
        self._newest: State | None = None
        self._holding = threading.Event()
        self._released = threading.Event()
        self._keeper: threading.Thread | None = None
        self._missed = 0

    def status(self) -> dict[str, Any]:
        connection = Connection(self._path)
        try:
            answer: dict[str, Any] = connection.ask("status")["status"]
            return answer
        finally:
            connection.close()

    def state(self) -> State:
        if self._states is None:
            self._states = Connection(self._path)
            self._states.ask("watch", topics=["state"])
        return self._receive()

    def next_state(self) -> State:
        if self._keeper is not None and not self._keeper.is_alive() and self._holding.is_set():
            raise ConnectionError("the connection that holds the drive is lost")
        self._raise_rejected()
        return self._receive()

    def _receive(self) -> State:
        """The newest state that has not been given yet; waits for one."""
        assert self._states is not None
        newest: dict[str, Any] | None = None
        wait = _SILENCE
        while (line := self._states.take(wait)) is not None:
            if "missed" in line:
                self._missed += int(line["missed"])
            elif line.get("topic") == "state":
                newest = line
                wait = 0.0
        if newest is None:
            raise TimeoutError(f"no state for {_SILENCE} s")
        self._newest = state(newest)
        return self._newest

    def begin(self, timeout: float) -> State:
        deadline = time.monotonic() + timeout
        self._setpoints = Connection(self._path)
        self._released.clear()
        try:
            self._make_external()
            while True:
                self._await_ready(deadline)
                try:
                    return self._arm()
                except ArmError as error:
                    # The mode has changed meanwhile, for example because the board restarts.
                    if "arm: mode" not in str(error) or time.monotonic() > deadline:
                        raise
                    self._let_go()
        except BaseException:
            self.end()
            raise

    def _await_ready(self, deadline: float) -> None:
        now = self.state()
        while now.mode != "ready":
            # Standstill is a set-point too; without one the car is not ready.
            self._standstill()
            if time.monotonic() > deadline:
                raise ArmError(f"the car is not ready: mode {now.mode}, because of {now.reason}")
            now = self._receive()

    def _arm(self) -> State:
        self._holding.set()
        self._standstill()
        more = {"uncalibrated": True} if self._uncalibrated else {}
        self._control.send("arm", attendance="hold", **more)
        self._keeper = threading.Thread(target=self._keep, daemon=True, name="singletrack-hold")
        self._keeper.start()
        self._await_armed()
        deadline = time.monotonic() + _SILENCE
        while not (now := self._receive()).driving:
            if time.monotonic() > deadline:
                raise ArmError(f"the drive has ended at once: mode {now.mode}, {now.reason}")
        return now

    def _let_go(self) -> None:
        """Ends the renewals; begins with a new connection, which has no old answers."""
        self._holding.clear()
        if self._keeper is not None:
            self._keeper.join(1.0)
            self._keeper = None
        self._control.close()
        self._control = Connection(self._path)

    def _make_external(self) -> None:
        """Makes the reference external, unless it is."""
        assert self._setpoints is not None
        self._setpoints.send("setpoint", velocity_m_s=[0.0, 0.0])
        self._setpoints.send("status")
        # A set-point that is obeyed has no answer.
        answer = self._setpoints.take(5.0)
        if answer is None:
            raise TimeoutError("no answer to setpoint")
        if answer.get("rejected") == "not-external":
            self._setpoints.take(5.0)
            self._control.ask("set-reference", 10.0, reference={"kind": "external"})
        elif "rejected" in answer:
            raise Rejected(answer.get("error", ""), answer["rejected"])

    def _await_armed(self) -> None:
        deadline = time.monotonic() + 15.0
        while True:
            answer = self._control.take(max(0.0, deadline - time.monotonic()))
            if answer is None:
                raise ArmError("no answer to arm")
            if answer.get("ok") is True:
                return
            if "error" in answer:
                raise ArmError(answer["error"])
            if "ended" in answer:
                raise ArmError(f"the drive has ended: {answer['ended'].get('reason')}")

    def _standstill(self) -> None:
        if self._setpoints is not None and not self._released.is_set():
            self._setpoints.send("setpoint", velocity_m_s=[0.0, 0.0])

    def _keep(self) -> None:
        """Renews the drive; and stands still until the program's first set-point.

        A program that hangs sends no set-points, which stops the car, whatever this does.
        """
        last_hold = 0.0
        try:
            while self._holding.is_set():
                now = time.monotonic()
                if now - last_hold >= _HOLD:
                    self._control.send("hold")
                    last_hold = now
                self._standstill()
                time.sleep(_STANDSTILL)
        except OSError:
            return

    def setpoint(self, keys: dict[str, Any]) -> None:
        assert self._setpoints is not None
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
                raise Rejected(answer.get("error", ""), answer["rejected"])

    def end(self) -> State | None:
        try:
            return self._disarm()
        finally:
            for connection in (self._setpoints, self._states):
                if connection is not None:
                    connection.close()
            self._setpoints = self._states = None
            self._let_go()

    def _disarm(self) -> State | None:
        if not self._holding.is_set():
            return self._newest
        try:
            self._control.send("disarm")
            deadline = time.monotonic() + 15.0
            while self._states is not None and time.monotonic() < deadline:
                now = self._receive()
                if now.mode in ("idle", "ready", "fault", "disconnected"):
                    return now
        except (OSError, TimeoutError):
            # The daemon has gone, or the connection; either stops the car.
            pass
        return self._newest

    def stop(self) -> None:
        connection = Connection(self._path)
        try:
            connection.ask("stop")
        finally:
            connection.close()

    def close(self) -> None:
        self._holding.clear()
        for connection in (self._control, self._setpoints, self._states):
            if connection is not None:
                connection.close()
