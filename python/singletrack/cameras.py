"""Poses of a motion capture system, with capture times: OptiTrack (NatNet), VRPN and Qualisys.

It needs no car and no daemon::

    from singletrack.cameras import Cameras, discover

    for server in discover():
        print(server.kind, server.address)
    with Cameras("192.168.1.10") as cameras:
        for body in cameras.bodies():
            print(body.name, body.rate_hz)
        for pose in cameras.poses("car"):
            print(pose.captured_s, pose.position_m, pose.latency_s)

Times are those of ``time.monotonic()``. Poses are in a right-handed frame with z up, in m;
quaternions are x, y, z, w.
"""

from __future__ import annotations

import asyncio
import json
import math
import select
import socket
import time
from collections import deque
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass

from . import _native
from ._closing import Closing
from ._errors import SingletrackError

__all__ = ["Body", "Cameras", "CamerasError", "Pose", "Server", "discover"]

_Vector = tuple[float, float, float]
_Quaternion = tuple[float, float, float, float]


class CamerasError(SingletrackError):
    """The cameras send nothing that can be used; the text says why, and what to look at."""


@dataclass(frozen=True)
class Server:
    """A server that answers on the network."""

    #: ``natnet`` or ``qualisys``; VRPN can't be asked.
    kind: str
    #: Its IPv4 address.
    address: str


@dataclass(frozen=True)
class Pose:
    """A rigid body in a frame of the cameras."""

    #: The body's name; ``None`` if the server lists none.
    name: str | None
    #: Its number in the stream.
    id: int
    #: The server's number of the frame.
    frame: int
    #: Position of the body's pivot, in m.
    position_m: _Vector
    #: Unit quaternion x, y, z, w.
    orientation_xyzw: _Quaternion
    #: Mean distance of the markers from the model, in m; 0 where the server does not send it.
    mean_error_m: float
    #: When the frame arrived.
    received_s: float
    #: The middle of the exposure on this computer's clock; ``None`` without a usable time.
    captured_s: float | None
    #: Bound on the error of ``captured_s``.
    uncertainty_s: float
    #: How it was found: ``mid-exposure-echo``, ``mid-exposure-min-delay`` or ``frame-timestamp``.
    time_source: str | None

    @property
    def latency_s(self) -> float:
        """From exposure to arrival; NaN without a capture time."""
        return math.nan if self.captured_s is None else self.received_s - self.captured_s

    @property
    def yaw_rad(self) -> float:
        """Angle about z."""
        x, y, z, w = self.orientation_xyzw
        return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


@dataclass(frozen=True)
class Body:
    """A rigid body that the server lists."""

    #: Its name; ``None`` if the server lists none.
    name: str | None
    #: Its number in the stream.
    id: int
    #: Poses a second.
    rate_hz: float
    #: Part of the frames that list it in which it is seen.
    seen: float
    #: Its last pose.
    pose: Pose | None


class Cameras(Closing):
    """A client of one server.

    Args:
        server: IPv4 address of the computer with the cameras' program.
        kind: ``natnet`` (OptiTrack Motive), ``vrpn`` or ``qualisys``.
        port: Port of the server, if it is not the usual one.
        transport: ``unicast``, ``multicast`` (NatNet), or ``tcp`` (VRPN, Qualisys).
        interface: Address of this computer in the cameras' network; multicast needs it.
        up_axis: The server's axis that points up, ``y`` or ``z``: ``y`` with NatNet, else ``z``.
        group: Multicast group, if it is not the usual one.
        data_port: Port of the multicast frames, if it is not the usual one.

    Raises:
        ValueError: An argument can't be used; the text names it.
        OSError: A socket can't be opened.
    """

    def __init__(
        self,
        server: str,
        kind: str = "natnet",
        *,
        port: int | None = None,
        transport: str = "unicast",
        interface: str = "0.0.0.0",
        up_axis: str | None = None,
        group: str | None = None,
        data_port: int | None = None,
    ) -> None:
        self._session = _native.CameraSession(
            server,
            kind=kind,
            port=port,
            transport=transport,
            interface=interface,
            up_axis=up_axis,
            group=group,
            data_port=data_port,
        )
        self._server = f"the {kind} server {server}"
        self._poses: deque[Pose] = deque(maxlen=10_000)
        #: Of each body: how often it was listed, how often seen, and its name.
        self._listed: dict[int, tuple[int, int, str | None]] = {}
        self._notes: list[str] = []
        self._stream: socket.socket | None = None
        self._wanted: tuple[tuple[str, int], int] | None = None
        self._unused = b""
        self._command = _datagrams((interface, 0))
        self._sockets = [self._command]
        if transport == "multicast":
            try:
                self._sockets.append(_group(group or "239.255.42.99", data_port or 1511, interface))
            except OSError:
                self._command.close()
                raise

    def close(self) -> None:
        """Leaves the server."""
        if self._command.fileno() < 0:
            return
        self._session.close()
        self._send()
        for one in (*self._sockets, self._stream):
            if one is not None:
                one.close()

    @property
    def counters(self) -> dict[str, int]:
        """Frames taken, lost, late and malformed so far."""
        return self._session.counters()

    @property
    def notes(self) -> list[str]:
        """What an operator should know, in the order in which it was noticed."""
        return list(dict.fromkeys(self._notes))

    def poses(self, body: str | None = None, *, timeout_s: float = 5.0) -> Iterator[Pose]:
        """The poses from now on, of one body or of all.

        Args:
            body: The body's name.
            timeout_s: The longest wait for the next one.

        Raises:
            CamerasError: None came for that long; the text says what the server does.
        """
        for pose in self._next(body, timeout_s):
            if pose is None:
                self._poll(0.1)
            else:
                yield pose

    async def poses_async(
        self, body: str | None = None, *, timeout_s: float = 5.0
    ) -> AsyncIterator[Pose]:
        """The same for asyncio: ``async for pose in cameras.poses_async("car")``.

        Args:
            body: The body's name.
            timeout_s: The longest wait for the next one.

        Raises:
            CamerasError: None came for that long; the text says what the server does.
        """
        for pose in self._next(body, timeout_s):
            if pose is None:
                await asyncio.to_thread(self._poll, 0.1)
            else:
                yield pose

    def bodies(self, seconds: float = 1.0, *, timeout_s: float = 5.0) -> list[Body]:
        """What the server lists, watched for some seconds after the first frame.

        Args:
            seconds: How long to look.
            timeout_s: The longest wait for the first frame.

        Raises:
            CamerasError: No frame came; the text says what the server does.
        """
        self._listed.clear()
        begin = time.monotonic()
        while not self._listed:
            self._check(None, begin, timeout_s)
            self._poll(0.1)
        self._listed.clear()
        self._poses.clear()
        begin = time.monotonic()
        taken: list[Pose] = []
        while time.monotonic() < begin + seconds:
            self._poll(0.02)
            taken.extend(self._take(None))
        found = []
        for number, (frames, seen, name) in sorted(self._listed.items()):
            last = next((pose for pose in reversed(taken) if pose.id == number), None)
            found.append(Body(name, number, seen / seconds, seen / max(frames, 1), last))
        return found

    def record(self, path: str, seconds: float, body: str | None = None) -> int:
        """Writes poses into a new MCAP file: a topic ``/poses/NAME`` for each body.

        Viewers know the messages as ``foxglove.PoseInFrame``.

        Args:
            path: The file.
            seconds: How long to record.
            body: The name of one body, or all.

        Returns:
            The number of poses.

        Raises:
            CamerasError: No pose came for 5 s.
            OSError: The file exists, or can't be written.
        """
        writer = _native.PoseWriter(path)
        offset_ns = time.time_ns() - time.monotonic_ns()
        until, count = time.monotonic() + seconds, 0
        try:
            for pose in self.poses(body):
                received_ns = int(pose.received_s * 1e9) + offset_ns
                captured_s = pose.received_s if pose.captured_s is None else pose.captured_s
                captured_ns = int(captured_s * 1e9) + offset_ns
                name = pose.name or str(pose.id)
                writer.write(name, captured_ns, received_ns, _message(pose, captured_ns))
                count += 1
                if time.monotonic() >= until:
                    break
        finally:
            writer.close()
        return count

    def _next(self, body: str | None, timeout_s: float) -> Iterator[Pose | None]:
        """The poses from now on, and ``None`` whenever the next must be waited for."""
        self._poses.clear()
        since = time.monotonic()
        while True:
            for pose in self._take(body):
                since = time.monotonic()
                yield pose
            self._check(body, since, timeout_s)
            yield None

    def _take(self, body: str | None) -> Iterator[Pose]:
        while self._poses:
            pose = self._poses.popleft()
            if body is None or pose.name == body:
                yield pose

    def _check(self, body: str | None, since: float, timeout_s: float) -> None:
        if time.monotonic() < since + timeout_s:
            return
        if not self._session.answers():
            why = "nothing answers: address, port, program, streaming, firewall?"
        elif not self._listed:
            why = "it answers and sends no bodies: is it measuring, and streaming rigid bodies?"
        elif body is not None:
            why = f"it sends no pose of {body!r}: see bodies()"
        else:
            why = "no body is seen"
        raise CamerasError("; ".join([f"{self._server}: {why}", *self.notes]))

    def _poll(self, longest_s: float) -> None:
        """Waits until something arrives or is due, and handles it."""
        wake_ns = self._session.wake_ns()
        now_ns = time.monotonic_ns()
        wait = longest_s if wake_ns is None else min(longest_s, max(0, wake_ns - now_ns) * 1e-9)
        self._keep_stream()
        files = [*self._sockets, *([self._stream] if self._stream else [])]
        ready, _, _ = select.select(files, [], [], wait)
        for one in ready:
            if one is self._stream:
                self._receive()
            else:
                self._datagrams(one)
        self._said(self._session.timeout(time.monotonic_ns()))
        self._send()

    def _datagrams(self, one: socket.socket) -> None:
        # A flood must not keep the session from acting on silence.
        for _ in range(64):
            try:
                data, source = one.recvfrom(65_535)
            except OSError:
                return
            self._said(self._session.datagram(time.monotonic_ns(), source, data))

    def _receive(self) -> None:
        assert self._stream is not None
        try:
            data = self._stream.recv(65_536)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._lose_stream()
            return
        self._unused += data
        used = self._said(self._session.received(time.monotonic_ns(), self._unused))
        self._unused = self._unused[used:]

    def _keep_stream(self) -> None:
        wanted = self._session.stream()
        if wanted == self._wanted:
            return
        if self._stream is not None:
            self._stream.close()
        self._stream, self._unused, self._wanted = None, b"", wanted
        if wanted is None:
            return
        try:
            self._stream = socket.create_connection(wanted[0], timeout=1.0)
            self._stream.setblocking(False)
        except OSError:
            self._said(self._session.closed(time.monotonic_ns()))
            return
        local, port = self._stream.getsockname()[0], self._command.getsockname()[1]
        self._said(self._session.opened(time.monotonic_ns(), local, port))

    def _lose_stream(self) -> None:
        if self._stream is not None:
            self._stream.close()
        self._stream, self._unused = None, b""
        self._said(self._session.closed(time.monotonic_ns()))

    def _send(self) -> None:
        while (message := self._session.transmit(time.monotonic_ns())) is not None:
            on_stream, to, data = message
            try:
                if not on_stream:
                    self._command.sendto(data, to)
                elif self._stream is not None:
                    self._stream.sendall(data)
            except OSError:
                # The session repeats what matters.
                pass

    def _said(self, said: _native._Said) -> int:
        used, bodies, notes = said
        self._notes.extend(notes)
        for number, name, frame, received_ns, capture, pose in bodies:
            frames, seen, _ = self._listed.get(number, (0, 0, None))
            self._listed[number] = frames + 1, seen + (pose is not None), name
            if pose is None:
                continue
            captured_ns, bound_ns, source = capture or (None, 0, None)
            position, orientation, error = pose
            self._poses.append(
                Pose(
                    name,
                    number,
                    frame,
                    position,
                    orientation,
                    error,
                    received_ns * 1e-9,
                    None if captured_ns is None else captured_ns * 1e-9,
                    bound_ns * 1e-9,
                    source,
                )
            )
        return used


def discover(seconds: float = 1.0, address: str | None = None) -> list[Server]:
    """The NatNet and Qualisys servers that answer, on this computer and in its network.

    Args:
        seconds: How long to wait for answers.
        address: What is asked in place of both: a computer, or the broadcast address of a network.
    """
    asked = ["127.0.0.1", "255.255.255.255"] if address is None else [address]
    found: list[Server] = []
    kinds = {}
    try:
        for index in range(2):
            one = _datagrams(("0.0.0.0", 0))
            one.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            kind, port, question = _native.camera_questions(one.getsockname()[1])[index]
            kinds[one] = kind
            for to in asked:
                try:
                    one.sendto(question, (to, port))
                except OSError:
                    # Without a network, this computer's own servers are found.
                    pass
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            ready, _, _ = select.select(list(kinds), [], [], left)
            for one in ready:
                try:
                    _, source = one.recvfrom(2_048)
                except OSError:
                    continue
                server = Server(kinds[one], source[0])
                if server not in found:
                    found.append(server)
    finally:
        for one in kinds:
            one.close()
    return found


def _datagrams(address: tuple[str, int]) -> socket.socket:
    one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    one.setblocking(False)
    try:
        one.bind(address)
    except OSError:
        one.close()
        raise
    return one


def _group(group: str, port: int, interface: str) -> socket.socket:
    one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    one.setblocking(False)
    try:
        # Other clients on this computer may listen to the same group.
        one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        # Bound to the group's address, the socket receives its datagrams only.
        one.bind((group, port))
        both = socket.inet_aton(group) + socket.inet_aton(interface)
        one.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, both)
    except OSError:
        one.close()
        raise
    return one


def _message(pose: Pose, captured_ns: int) -> str:
    position = dict(zip("xyz", pose.position_m))
    orientation = dict(zip("xyzw", pose.orientation_xyzw))
    latency = None if pose.captured_s is None else pose.latency_s
    return json.dumps(
        {
            "timestamp": {"sec": captured_ns // 10**9, "nsec": captured_ns % 10**9},
            "frame_id": "map",
            "pose": {"position": position, "orientation": orientation},
            "mean_error_m": pose.mean_error_m,
            "latency_s": latency,
            "uncertainty_s": pose.uncertainty_s,
        }
    )
