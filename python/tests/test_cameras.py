"""The cameras without a car: every kind of simulated server over real sockets."""

from __future__ import annotations

import asyncio
import json
import math
import os
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from singletrack import cameras
from singletrack.cameras import Cameras, CamerasError
from conftest import _free_port, _wait

KINDS = ["natnet", "vrpn", "qualisys"]


class Server:
    """The simulator's cameras of a kind; the car stands."""

    def __init__(self, folder: Path, kind: str) -> None:
        self.kind, self.port = kind, _free_port()
        line = folder / "uno"
        self.process = subprocess.Popen(
            [
                os.environ["SINGLETRACK_SIM"],
                *("--cameras", kind, "--port", str(line)),
                *("--command-port", str(self.port), "--data-port", str(_free_port())),
                *("--start", "1,-0.5,90"),
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        _wait(line)

    def client(self) -> Cameras:
        # The simulated servers of all kinds have y up.
        return Cameras("127.0.0.1", self.kind, port=self.port, up_axis="y")


@pytest.fixture(params=KINDS)
def server(
    tmp_path: Path, request: pytest.FixtureRequest, programs: None
) -> Iterator[Server]:
    running = Server(tmp_path, request.param)
    yield running
    running.process.terminate()
    running.process.wait(10)


def test_poses_have_a_place_and_a_capture_time_before_their_arrival(server: Server) -> None:
    with server.client() as client:
        poses = client.poses("car")
        seen = [next(poses) for _ in range(60)]
    for pose in seen[30:]:
        x, y, _ = pose.position_m
        assert math.hypot(x - 1, y + 0.5) < 0.5
        assert pose.yaw_rad == pytest.approx(math.pi / 2, abs=0.05)
        assert pose.captured_s is not None and pose.captured_s <= pose.received_s
        assert 0 <= pose.latency_s < 0.1 and 0 <= pose.uncertainty_s < 0.1
        assert pose.received_s <= time.monotonic()
    assert all(one.frame < next_.frame for one, next_ in zip(seen, seen[1:]))


def test_the_list_of_bodies_names_the_car_with_its_rate(server: Server) -> None:
    with server.client() as client:
        bodies = {body.name: body for body in client.bodies(0.5)}
        assert client.counters["frames"] > 10
    car = bodies["car"]
    assert car.rate_hz > 30 and car.seen > 0.9 and car.pose is not None


def test_a_record_has_a_topic_for_each_body_and_is_not_overwritten(
    server: Server, tmp_path: Path
) -> None:
    path = tmp_path / "poses.mcap"
    with server.client() as client:
        count = client.record(str(path), 0.3, "car")
        with pytest.raises(OSError, match="poses.mcap"):
            client.record(str(path), 0.3)
    data = path.read_bytes()
    assert count > 5 and data.startswith(b"\x89MCAP0") and data.endswith(b"MCAP0\r\n")
    assert b"/poses/car" in data and b"foxglove.PoseInFrame" in data


def test_asyncio_gets_the_same_poses(server: Server) -> None:
    async def first() -> cameras.Pose:
        with server.client() as client:
            async for pose in client.poses_async("car"):
                return pose
        raise AssertionError

    assert asyncio.run(first()).name == "car"


def test_a_body_that_is_not_sent_is_named(server: Server) -> None:
    with server.client() as client, pytest.raises(CamerasError, match="no pose of 'truck'"):
        next(client.poses("truck", timeout_s=1.0))


def test_a_server_that_does_not_answer_is_named_with_what_to_look_at() -> None:
    port = _free_port()
    with Cameras("127.0.0.1", port=port) as client:
        with pytest.raises(CamerasError, match="natnet server 127.0.0.1: nothing answers"):
            next(client.poses(timeout_s=0.5))


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"server": "motive"}, "server is \"motive\": write an IPv4 address"),
        ({"kind": "vicon"}, "kind is \"vicon\": it is one of natnet, vrpn, qualisys"),
        ({"transport": "tcp"}, "NatNet sends frames on UDP"),
        ({"up_axis": "x"}, "up_axis is \"x\": it is one of y, z"),
        ({"transport": "multicast"}, "multicast needs the local address"),
    ],
)
def test_an_argument_that_can_not_be_used_is_named(options: dict[str, str], text: str) -> None:
    arguments = {"server": "127.0.0.1", **options}
    with pytest.raises(ValueError, match=text):
        Cameras(**arguments)  # type: ignore[arg-type]


def test_servers_of_this_computer_are_found(tmp_path: Path) -> None:
    # A server with the answer of a Qualisys server, at its usual port.
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.37.1", 22_226))
        one.settimeout(5)
        found = []

        def ask() -> None:
            found.extend(cameras.discover(0.5, "127.0.37.1"))

        thread = threading.Thread(target=ask)
        thread.start()
        _, source = one.recvfrom(100)
        one.sendto(b"answer", source)
        thread.join()
    assert found == [cameras.Server("qualisys", "127.0.37.1")]


def test_a_message_is_one_that_viewers_know() -> None:
    pose = cameras.Pose("car", 1, 2, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0), 0.0, 5.0, 4.9, 0.0, None)
    message = json.loads(cameras._message(pose, 1_500_000_000))
    assert message["timestamp"] == {"sec": 1, "nsec": 500_000_000}
    assert message["pose"]["orientation"] == {"x": 0, "y": 0, "z": 0, "w": 1}
    assert message["latency_s"] == pytest.approx(0.1)
