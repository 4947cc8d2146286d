"""Clients that others wrote read the simulated VRPN and Qualisys servers.

    cameras.py SINGLETRACK_SIM

The car stands where the simulator puts it. VRPN's own library (in `motioncapture`) takes poses in
datagrams; QTM's own two clients take them over TCP and in datagrams, as matrices and as angles.
"""

import asyncio
import math
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path

import motioncapture
import qtm_rt

# Of the standing car, Y up: x, height, -y in m, and the yaw.
POSITION = [0.57, 0.12, 0.39]
YAW = math.radians(54)
# How long a client looks.
SECONDS = 2.0
NAMES = {"car", "wand", "carrier"}


@contextmanager
def simulator(program, kind):
    with tempfile.TemporaryDirectory() as folder:
        command = [program, "--cameras", kind, "--port", f"{folder}/board", "--duration", "60s"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            # The last line of its introduction.
            while "Ctrl-C" not in process.stdout.readline():
                assert process.poll() is None, f"{kind}: the simulator has ended"
            yield
        finally:
            process.terminate()
            process.wait()


def near(found, expected, bound):
    assert all(abs(a - b) < bound for a, b in zip(found, expected, strict=True)), (found, expected)


def by_motioncapture(kind):
    cameras = motioncapture.connect(kind, {"hostname": "127.0.0.1"})
    until = time.monotonic() + SECONDS
    frames, bodies = 0, {}
    while time.monotonic() < until:
        cameras.waitForNextFrame()
        frames += 1
        bodies.update(cameras.rigidBodies)
    assert set(bodies) == NAMES, set(bodies)
    car = bodies["car"]
    near(car.position, POSITION, 0.005)
    turn = car.rotation
    near([abs(turn.y), abs(turn.w)], [math.sin(YAW / 2), math.cos(YAW / 2)], 0.01)
    return frames


async def by_qtm_rt():
    connection = await qtm_rt.connect("127.0.0.1", port=22223, version="1.19")
    assert connection is not None
    assert await connection.byte_order() == b"Byte order is little endian"
    xml = (await connection.get_parameters(["6d"])).decode()
    assert all(f"<Name>{name}</Name>" in xml for name in NAMES), xml
    packets = []
    await connection.stream_frames(components=["6d", "6dres"], on_packet=packets.append)
    await asyncio.sleep(SECONDS)
    await connection.stream_frames_stop()
    numbers = [packet.framenumber for packet in packets]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    header, bodies = packets[-1].get_6d_residual()
    assert header.body_count == len(NAMES)
    position, rotation, residual = bodies[-1]
    near([metre * 1000 for metre in POSITION], position, 5)
    matrix = rotation.matrix
    # Columns: the body's x axis comes first.
    near(matrix[:3], [math.cos(YAW), 0, -math.sin(YAW)], 0.02)
    assert 0 < residual.residual < 1
    plain = packets[-1].get_6d()[1][-1]
    assert plain[0] == position and plain[1] == rotation
    connection.disconnect()
    return len(packets)


def main():
    program = Path(sys.argv[1]).resolve()
    for kind, clients in [
        ("vrpn", {"VRPN's own library": lambda: by_motioncapture("vrpn")}),
        (
            "qualisys",
            {
                "QTM's Python client": lambda: asyncio.run(by_qtm_rt()),
                "QTM's C++ client": lambda: by_motioncapture("qualisys"),
            },
        ),
    ]:
        with simulator(program, kind):
            for name, client in clients.items():
                frames = client()
                assert frames > 20, (name, frames)
                print(f"{kind}: {name} read {frames} frames of {sorted(NAMES)}")


main()
