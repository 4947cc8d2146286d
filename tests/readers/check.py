"""Opens a record as others do, and compares all of it with what we say it holds.

    check.py SINGLETRACK RECORD

SINGLETRACK is our command line, RECORD a finished record. Two readers that know
nothing of this project decode every message by the definitions in the file alone.
What they find is compared with each other, with `singletrack dump`, and, for the
topics of ROS's own types, with what follows from our own. Then the same for the
record that `singletrack recover` makes of a cut one.
"""

import json
import math
import subprocess
import sys
from collections import defaultdict
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

OWN = ["tick", "telemetry", "status", "pose", "log", "drops", "configuration"]
# Of no distribution of ROS itself.
EXTRA_TYPES = {
    "ackermann_msgs/msg/AckermannDrive",
    "ackermann_msgs/msg/AckermannDriveStamped",
}
# Topics that a drive of the simulated car must have messages on.
EXPECTED = [
    "/singletrack/tick",
    "/singletrack/telemetry",
    "/singletrack/status",
    "/singletrack/pose",
    "/odom",
    "/tf",
    "/mocap/pose",
    "/imu",
    "/cmd",
    "/reference",
    "/point_p",
    "/diagnostics",
]


@dataclass
class Received:
    log_time: int
    message: Any


@dataclass
class Clocks:
    """One moment on the monotonic clock and on the wall, in ns."""

    monotonic: int
    wall: int

    def at(self, monotonic: int) -> int:
        return self.wall + monotonic - self.monotonic


def check(condition: bool, what: str) -> None:
    if not condition:
        sys.exit(f"check.py: {what}")


def read_with_rosbags(path: Path) -> dict[str, list[Received]]:
    found: dict[str, list[Received]] = defaultdict(list)
    with AnyReader([path]) as reader:
        check_types(reader)
        for connection, time, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found[connection.topic].append(Received(time, message))
    return found


def check_types(reader: AnyReader) -> None:
    """What we call by a name of ROS's is what ROS calls so."""
    ros = get_typestore(Stores.ROS2_HUMBLE).fielddefs
    for connection in reader.connections:
        if connection.msgtype.startswith("singletrack_msgs/"):
            continue
        types = get_types_from_msg(connection.msgdef.data, connection.msgtype)
        for name, (constants, members) in types.items():
            if name in EXTRA_TYPES:
                continue
            check(name in ros, f"there is no {name} in ROS 2")
            ours, theirs = (list(constants), members), (list(ros[name][0]), ros[name][1])
            check(ours == theirs, f"{name} is {ours}, and in ROS 2 {theirs}")


def read_with_mcap(path: Path) -> tuple[dict[str, list[Received]], Clocks]:
    found: dict[str, list[Received]] = defaultdict(list)
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            found[channel.topic].append(Received(message.log_time, decoded))
        about = {entry.name: entry.metadata for entry in reader.iter_metadata()}
        attached = {entry.name for entry in reader.iter_attachments()}
        summary = reader.get_summary()
    check("configuration.toml" in attached, f"{path} has no configuration attached")
    check(
        summary is not None
        and summary.statistics is not None
        and summary.statistics.message_count == sum(map(len, found.values())),
        f"the statistics of {path} are wrong",
    )
    start = about["singletrack"]
    return found, Clocks(int(start["start_monotonic_ns"]), int(start["start_wall_ns"]))


def same(one: Any, other: Any) -> bool:
    """Whether two readers decoded the same, to the bit where that shows."""
    if is_dataclass(one):
        names = [field.name for field in fields(one) if hasattr(other, field.name)]
        return names == list(other.__slots__) and all(
            same(getattr(one, name), getattr(other, name)) for name in names
        )
    if hasattr(one, "__len__") and not isinstance(one, str):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, float) and math.isnan(one):
        return math.isnan(other)
    return bool(one == other)


def shows(shown: Any, message: Any, name: str) -> bool:
    """Whether the field of a message is what our dump shows of it."""
    value = getattr(message, name)
    if shown is None:
        absent = getattr(message, f"has_{name}", None)
        if absent is not None:
            return absent is False
        return value == 0 or math.isnan(value)
    if not getattr(message, f"has_{name}", True):
        return False
    if isinstance(shown, dict):
        return all(shows(shown[part], value, part) for part in shown)
    if isinstance(shown, list):
        return len(shown) == len(value) and all(
            shows(part[key], element, key)
            for part, element in zip(shown, value)
            for key in part
        )
    if isinstance(shown, str) and not isinstance(value, str):
        # A word stands for one of the constants of the message.
        word = "_" + shown.upper().replace("-", "_")
        return any(
            field.name.endswith(word) and field.default == value for field in fields(message)
        )
    return bool(shown == value)


def dump(tool: str, path: Path, topic: str) -> list[dict[str, Any]]:
    lines = subprocess.run(
        [tool, "dump", path, "--topic", topic, "--format", "json"],
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    ).stdout.splitlines()
    entries = [json.loads(line) for line in lines]
    for entry in entries:
        check(entry.pop("topic") == topic, f"dump --topic {topic} prints something else")
    return entries


def check_own(found: dict[str, list[Received]], dumped: dict[str, list[dict[str, Any]]]) -> None:
    for topic, entries in dumped.items():
        received = found.get(f"/singletrack/{topic}", [])
        check(
            len(received) == len(entries),
            f"{len(received)} messages of {topic}, and dump prints {len(entries)}",
        )
        for entry, one in zip(entries, received):
            for name, shown in entry.items():
                check(
                    shows(shown, one.message, name),
                    f"{topic}.{name} is {shown}, and was read as {getattr(one.message, name)}",
                )


def stamp(header: Any) -> int:
    return int(header.stamp.sec * 1_000_000_000 + header.stamp.nanosec)


def yaw(quaternion: Any) -> float:
    check(quaternion.x == quaternion.y == 0.0, "a yaw that is not about z")
    return 2.0 * math.atan2(quaternion.z, quaternion.w)


def near(one: float, other: float) -> bool:
    return abs(one - other) < 1e-9


def turned(one: float, other: float) -> bool:
    return near(math.remainder(one - other, 2.0 * math.pi), 0.0)


def check_standard(
    found: dict[str, list[Received]], dumped: dict[str, list[dict[str, Any]]], clocks: Clocks
) -> None:
    """What is under ROS's types follows from our own, message by message."""

    def pairs(topic: str, entries: list[dict[str, Any]]) -> list[tuple[dict[str, Any], Any]]:
        received = [one.message for one in found[topic]]
        check(
            len(received) == len(entries),
            f"{len(received)} messages on {topic} instead of {len(entries)}",
        )
        return list(zip(entries, received))

    ticks = dumped["tick"]
    estimated = [tick for tick in ticks if tick["estimate"]]
    for tick, odometry in pairs("/odom", estimated):
        estimate, pose = tick["estimate"], odometry.pose.pose
        frames = (odometry.header.frame_id, odometry.child_frame_id)
        linear, angular = odometry.twist.twist.linear, odometry.twist.twist.angular
        speed, sideslip = estimate["speed_m_s"], estimate["sideslip_rad"]
        check(
            frames == ("odom", "base_link")
            and stamp(odometry.header) == clocks.at(estimate["time_ns"])
            and (pose.position.x, pose.position.y) == (estimate["x_m"], estimate["y_m"])
            and turned(yaw(pose.orientation), estimate["yaw_rad"])
            and near(linear.x, speed * math.cos(sideslip))
            and near(linear.y, speed * math.sin(sideslip))
            and angular.z == estimate["yaw_rate_rad_s"]
            and odometry.pose.covariance[35] == tick["covariance"]["yaw_yaw"] > 0.0
            and odometry.twist.covariance[7] == tick["covariance"]["left_left"] > 0.0,
            f"{odometry} does not follow from {estimate}",
        )
    for (tick, message), odometry in zip(pairs("/tf", estimated), found["/odom"]):
        fixed, transform = message.transforms
        pose = odometry.message.pose.pose
        check(
            (fixed.header.frame_id, fixed.child_frame_id) == ("map", "odom")
            and transform.child_frame_id == "base_link"
            and transform.transform.translation.x == pose.position.x
            and transform.transform.rotation == pose.orientation,
            f"{transform} is not the pose of tick {tick['tick']}",
        )
    for tick, command in pairs("/cmd", [tick for tick in ticks if tick["command"]]):
        told = tick["command"]
        check(
            stamp(command.header) == clocks.at(tick["time_ns"])
            and abs(command.drive.speed - told["rear_speed_m_s"]) < 1e-6
            and abs(command.drive.steering_angle - told["steering_rad"]) < 1e-6,
            f"{command} is not {told}",
        )
    guided = [tick for tick in ticks if tick["reference"] and tick["reference"]["position"]]
    for tick, reference in pairs("/reference", guided):
        told = tick["reference"]["position"]
        check(
            (reference.point.x, reference.point.y) == (told["x_m"], told["y_m"]),
            f"{reference} is not {told}",
        )
    for tick, point in pairs("/point_p", [tick for tick in ticks if tick["point"]]):
        told = tick["point"]
        check(
            (point.point.x, point.point.y) == (told["x_m"], told["y_m"]),
            f"{point} is not {told}",
        )
    valid = [entry["pose"] for entry in dumped["pose"] if entry["pose"]]
    for told, pose in pairs("/mocap/pose", valid):
        position = pose.pose.position
        check(
            stamp(pose.header) == clocks.at(told["capture_time_ns"])
            and (position.x, position.y, position.z) == (told["x_m"], told["y_m"], told["z_m"])
            and turned(yaw(pose.pose.orientation), told["yaw_rad"]),
            f"{pose} is not {told}",
        )
    fresh = [
        entry
        for entry in dumped["telemetry"]
        if entry["imu"] == "fresh" and entry["imu_time_host_ns"] is not None
    ]
    for told, imu in pairs("/imu", fresh):
        check(
            stamp(imu.header) == clocks.at(told["imu_time_host_ns"])
            and imu.angular_velocity.z == told["yaw_rate_mrad_s"] / 1000.0
            and imu.linear_acceleration.y == told["left_acceleration_mm_s2"] / 1000.0
            and imu.orientation.w == told["attitude_w_q14"] / 16384.0,
            f"{imu} is not {told}",
        )
    for told, line in pairs("/rosout", dumped["log"]):
        check(line.msg == told["text"], f"{line} is not {told}")
    voltages = {entry["battery_mv"] / 1000.0 for entry in dumped["status"]}
    for one in found["/diagnostics"]:
        for status in one.message.status:
            for pair in status.values:
                if pair.key == "battery_V":
                    check(float(pair.value) in voltages, f"a battery of {pair.value} V")


def check_record(tool: str, path: Path) -> int:
    """Checks all of a record; how many messages it has."""
    found = read_with_rosbags(path)
    other, clocks = read_with_mcap(path)
    for topic in EXPECTED:
        check(len(found.get(topic, [])) > 10, f"{path} has hardly a message on {topic}")
    check(found.keys() == other.keys(), "the readers find other topics")
    for topic, received in found.items():
        check(len(received) == len(other[topic]), f"the readers count {topic} differently")
        for one, two in zip(received, other[topic]):
            check(
                one.log_time == two.log_time and same(one.message, two.message),
                f"the readers see {one} and {two}",
            )
    dumped = {topic: dump(tool, path, topic) for topic in OWN}
    check_own(found, dumped)
    check_standard(found, dumped, clocks)
    messages = sum(map(len, found.values()))
    print(f"{path.name}: {messages} messages on {len(found)} topics, as we say")
    return messages


def main() -> None:
    tool, record = sys.argv[1], Path(sys.argv[2])
    whole = check_record(tool, record)
    # As a killed recorder leaves it, or one whose disk was full.
    cut = record.with_suffix(".mcap.part")
    content = record.read_bytes()
    cut.write_bytes(content[: len(content) * 2 // 3])
    recovered = record.with_name("recovered.mcap")
    subprocess.run(
        [tool, "recover", cut, "--out", recovered], check=True, stdout=subprocess.DEVNULL
    )
    rest = check_record(tool, recovered)
    check(whole / 3 < rest < whole, f"{rest} of {whole} messages were recovered from two thirds")


if __name__ == "__main__":
    main()
