"""Checks singletrack-ros against rclpy: the daemon drives the simulated car in real time, and
this process is the laboratory's node.

Everything runs on loopback, best in a network namespace of its own. The arguments are the folder
with the programs and an empty one for what they write.
"""

import argparse
import atexit
import json
import math
import os
import pathlib
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import traceback
import xml.etree.ElementTree

import numpy
import rclpy
from ackermann_msgs.msg import AckermannDriveStamped
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseStamped, TwistStamped
from mcap.reader import make_reader
from nav_msgs.msg import Odometry, Path
from rcl_interfaces.msg import Log
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rosidl_adapter.parser import parse_message_file
from sensor_msgs.msg import Imu
from std_msgs.msg import String
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

# The circle of P: radius in m, speed in m/s. Below the speed of the first, proving metre.
RADIUS = 0.85
SPEED = 0.27
# The circle of G, of controllers that know no P: well inside the geofence.
INNER = 0.6
GAIN = 1.0
WHEELBASE = 0.26
STEERING_RATE = 0.5
NAMESPACE = "/car7"

# Above this lateness of the machine, in s, a failure is repeated; with this exit status.
TOO_LATE = 0.04
REPEAT = 75

ROOT = pathlib.Path(__file__).resolve().parents[2]
CONFIGURATION = ROOT / "host/daemon/singletrackd.example.toml"
MESSAGES = ROOT / "host/record/msg/singletrack_msgs"

ARGUMENTS = argparse.ArgumentParser()
ARGUMENTS.add_argument("programs", type=pathlib.Path)
ARGUMENTS.add_argument("folder", type=pathlib.Path)
ARGUMENTS.add_argument("--drive", type=float, default=6.0, help="seconds of each drive")
ARGUMENTS.add_argument("--stalled", type=float, default=5.0, help="seconds of a stopped subscriber")
ARGUMENTS.add_argument("--stall", action="store_true", help="be the subscriber that is stopped")

# The topics of the record and their types here.
TOPICS = {
    "odom": ("/odom", Odometry),
    "tf": ("/tf", TFMessage),
    "imu": ("/imu", Imu),
    "diagnostics": ("/diagnostics", DiagnosticArray),
    "point_p": ("/point_p", PointStamped),
    "reference": ("/reference", PointStamped),
    "mocap_pose": ("/mocap/pose", PoseStamped),
    "cmd": ("/cmd", AckermannDriveStamped),
    "/rosout": ("/rosout", Log),
}
RELIABLE = QoSProfile(depth=2000)
NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def seconds(stamp):
    return stamp.sec + stamp.nanosec * 1e-9


def quantiles(values):
    values = sorted(values)
    at = lambda part: values[min(len(values) - 1, int(part * len(values)))]
    return f"p50 {at(0.5) * 1e3:.2f} ms, p99 {at(0.99) * 1e3:.2f} ms, of {len(values)}"


def wait(what, condition, limit=20.0):
    end = time.monotonic() + limit
    while not condition():
        if time.monotonic() > end:
            raise SystemExit(f"never: {what}")
        time.sleep(0.01)


class Lab(Node):
    """The laboratory's node: keeps what it receives, and sends set-points."""

    def __init__(self):
        super().__init__("lab", namespace=NAMESPACE)
        self.raw = {name: [] for name in TOPICS}
        self.arrived = []
        self.whole = 0
        self.point = None
        self.odometry = None
        self.refused = {}
        for name, (_, kind) in TOPICS.items():
            self.create_subscription(
                kind, name, lambda raw, name=name: self.take(name, raw), RELIABLE, raw=True
            )
        self.velocities = self.create_publisher(TwistStamped, "point_velocity", 1)
        self.drives = self.create_publisher(AckermannDriveStamped, "drive", 1)
        self.twists = self.create_publisher(TwistStamped, "cmd_vel", 1)
        self.paths = self.create_publisher(Path, "path", 1)
        self.triggers = {
            name: self.create_client(Trigger, name) for name in ("arm", "disarm", "stop")
        }

    def take(self, name, raw):
        now = time.time()
        self.raw[name].append(bytes(raw))
        if name == "odom":
            odometry = deserialize_message(raw, Odometry)
            self.arrived.append((seconds(odometry.header.stamp), now))
            pose = odometry.pose.pose
            yaw = 2.0 * math.atan2(pose.orientation.z, pose.orientation.w)
            self.odometry = pose.position.x, pose.position.y, yaw, odometry.header.stamp
        elif name == "point_p":
            point = deserialize_message(raw, PointStamped).point
            self.point = (point.x, point.y)
        elif name == "diagnostics":
            for status in deserialize_message(raw, DiagnosticArray).status:
                if status.name == "singletrack-ros":
                    self.refused = {value.key: value.value for value in status.values}

    def header(self, message, frame, age=0.0):
        message.header.frame_id = frame
        stamp = time.time_ns() - int(age * 1e9)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
        return message

    def velocity(self, velocity, age=0.0):
        message = self.header(TwistStamped(), "map", age)
        message.twist.linear.x, message.twist.linear.y = velocity
        self.velocities.publish(message)

    def commands(self):
        return [deserialize_message(raw, AckermannDriveStamped) for raw in self.raw["cmd"]]

    def path(self, place):
        """The next second of a path: `place` gives the position at a time from now."""
        message = self.header(Path(), "map")
        for step in range(11):
            pose = self.header(PoseStamped(), "map", age=-0.1 * step)
            pose.pose.position.x, pose.pose.position.y = place(0.1 * step)
            message.poses.append(pose)
        self.paths.publish(message)

    def call(self, name):
        answer = self.triggers[name].call_async(Trigger.Request())
        wait(f"an answer of {name}", answer.done, 15.0)
        return answer.result()


class Circle:
    """P on a circle about the origin, counter-clockwise, in a proportional loop."""

    def __init__(self, lab):
        self.lab = lab
        self.begin = math.atan2(lab.point[1], lab.point[0])
        self.start = None
        self.errors = []

    def angle(self, after=0.0):
        now = time.monotonic()
        self.start = self.start or now
        return self.begin + SPEED / RADIUS * (now + after - self.start)

    def place(self, after=0.0):
        angle = self.angle(after)
        return RADIUS * math.cos(angle), RADIUS * math.sin(angle)

    def path(self):
        wanted, point = self.place(), self.lab.point
        self.errors.append(math.hypot(wanted[0] - point[0], wanted[1] - point[1]))
        return self.place

    def velocity(self):
        angle, wanted = self.angle(), self.place()
        feed = (-SPEED * math.sin(angle), SPEED * math.cos(angle))
        point = self.lab.point
        self.errors.append(math.hypot(wanted[0] - point[0], wanted[1] - point[1]))
        return [feed[axis] + GAIN * (wanted[axis] - point[axis]) for axis in (0, 1)]

    def curvature(self):
        """Of the arc to the point of the circle that is 0.5 m ahead, as pure pursuit has it."""
        x, y, yaw, _ = self.lab.odometry
        self.errors.append(abs(math.hypot(x, y) - INNER))
        angle = math.atan2(y, x) + 0.5 / INNER
        ahead = INNER * math.cos(angle) - x, INNER * math.sin(angle) - y
        left = math.cos(yaw) * ahead[1] - math.sin(yaw) * ahead[0]
        return 2.0 * left / (ahead[0] ** 2 + ahead[1] ** 2)

    def pure_pursuit(self):
        """A pure pursuit of F1TENTH: with the frame of its laser."""
        message = self.lab.header(AckermannDriveStamped(), "laser")
        message.drive.steering_angle = math.atan(WHEELBASE * self.curvature())
        message.drive.speed = SPEED
        self.lab.drives.publish(message)

    def wall_follower(self):
        """A wall follower that jerks the wheel: without a header, and with every field."""
        message = AckermannDriveStamped()
        side = 0.15 if time.monotonic() % 1.0 < 0.5 else -0.15
        message.drive.steering_angle = math.atan(WHEELBASE * self.curvature()) + side
        message.drive.steering_angle_velocity = STEERING_RATE
        message.drive.speed = SPEED
        message.drive.acceleration, message.drive.jerk = 1.0, 2.0
        self.lab.drives.publish(message)

    def nav2(self):
        """A controller of Nav2: header of the pose from which it has planned, in its costmap's frame."""
        message = TwistStamped()
        message.header.frame_id, message.header.stamp = "odom", self.lab.odometry[3]
        message.twist.linear.x, message.twist.angular.z = SPEED, SPEED * self.curvature()
        self.lab.twists.publish(message)


def every(interval, duration, act):
    """Calls `act` at the interval for the duration."""
    begin = time.monotonic()
    count = 0
    while (now := time.monotonic()) < begin + duration:
        act()
        count += 1
        time.sleep(max(0.0, begin + count * interval - now))


class System:
    """Simulator, daemon and singletrack-ros."""

    def __init__(
        self, arguments, folder, namespace=NAMESPACE, start="0.57,-0.39,54", port=1510, options=()
    ):
        self.programs = arguments.programs
        self.folder = folder
        self.options = ("--namespace", namespace, *options)
        self.socket = self.folder / "control.sock"
        board = self.folder / "board"
        text = CONFIGURATION.read_text()
        for pattern, value in (
            (r"^port = .*", f'port = "{board}"'),
            (r"^server = .*", 'server = "127.0.0.1"'),
            (r"^# command_port = .*", f"command_port = {port}"),
            (r"^#data_port = .*", f"data_port = {port + 1}"),
            (r"^#directory = .*", f'directory = "{self.folder}"'),
            (r"^#path = .*", f'path = "{self.socket}"'),
            (r'^kind = "circle"', 'kind = "external"'),
            (r"^(radius_m|angular_velocity_rad_s) = .*\n", ""),
            (r"^gain_per_s = .*", r"\g<0>\nfeed_forward = true"),
            (r"^\[supervisor\]", "[supervisor]\nrequire_calibration = false"),
        ):
            text = re.sub(pattern, value, text, flags=re.MULTILINE)
        configuration = self.folder / "car.toml"
        configuration.write_text(text)
        self.processes = {}
        atexit.register(self.kill)
        cameras = ["--command-port", port, "--data-port", port + 1]
        self.start("singletrack-sim", "--port", board, "--start", start, *cameras)
        wait("the simulator's port", board.exists)
        self.start("singletrackd", "--config", configuration)
        wait("the daemon's socket", self.socket.exists)
        self.start_node()

    def start_node(self):
        self.start("singletrack-ros", "--socket", self.socket, *self.options)

    def start(self, name, *arguments):
        log = open(self.folder / f"{name}.log", "w")
        command = [self.programs / name, *map(str, arguments)]
        self.processes[name] = subprocess.Popen(command, stdout=log, stderr=log)

    def status(self):
        command = [self.programs / "singletrack", "status", "--json"]
        command += ["--socket", self.socket]
        return json.loads(subprocess.run(command, check=True, capture_output=True).stdout)

    def mode(self):
        state = self.status()["state"] or {}
        return state.get("mode"), state.get("reason")

    def end(self):
        for name in ("singletrack-ros", "singletrackd", "singletrack-sim"):
            process = self.processes[name]
            process.send_signal(signal.SIGINT)
            process.wait(20)
            if process.returncode != 0 and name != "singletrack-sim":
                raise SystemExit(f"{name} ended with {process.returncode}")

    def kill(self):
        for process in self.processes.values():
            if process.poll() is None:
                process.kill()
                process.wait()


class Lateness:
    """How late this machine wakes a thread. A simulated car that is held up stops, as it should."""

    def __init__(self):
        self.longest = 0.0
        threading.Thread(target=self.run, daemon=True).start()

    def run(self):
        while True:
            begin = time.monotonic()
            time.sleep(0.005)
            self.longest = max(self.longest, time.monotonic() - begin - 0.005)


def drive(lab, system, name, act, arguments):
    """Arms, drives, and disarms by the services; returns the errors once settled."""
    every(0.02, 0.6, act)
    feeding = threading.Event()

    def feed():
        while not feeding.is_set():
            act()
            time.sleep(0.02)

    thread = threading.Thread(target=feed)
    thread.start()
    try:
        answer = lab.call("arm")
        assert answer.success, answer.message
        again = lab.call("arm")
        assert not again.success and "under way" in again.message, again.message
        time.sleep(arguments.drive)
        mode, reason = system.mode()
        assert mode == "driving", f"{name}: {mode}: {reason}"
        assert lab.call("disarm").success
    finally:
        feeding.set()
        thread.join()
    wait("the end of the drive", lambda: system.mode()[0] in ("idle", "ready"))


def check_latency(lab):
    """A thousand messages while the car stands."""
    begin = len(lab.arrived)
    wait("1,000 messages", lambda: len(lab.arrived) >= begin + 1000)
    delays = [now - stamp for stamp, now in lab.arrived[begin : begin + 1000]]
    print(f"/odom, from the stamp of its tick to rclpy: {quantiles(delays)}")


def check_velocity(lab, system, arguments):
    circle = Circle(lab)
    drive(lab, system, "velocity", lambda: lab.velocity(circle.velocity()), arguments)
    settled = circle.errors[len(circle.errors) // 2 :]
    print(f"TwistStamped: P within {max(settled):.3f} m of its place on the circle")
    assert max(settled) < 0.25, max(settled)


def check_public(lab, system, arguments):
    """Controllers of others drive along the circle, with the fields as those programs set them."""
    circles = []
    for name in ("pure_pursuit", "wall_follower", "nav2"):
        circle = Circle(lab)
        circles.append(circle)
        begin = len(lab.raw["cmd"])
        drive(lab, system, name, getattr(circle, name), arguments)
        settled = max(circle.errors[len(circle.errors) // 2 :])
        commands = lab.commands()[begin:]
        # Of the rear axle, in most of the drive: it begins and ends at rest, and is proved by a roll.
        exact = [abs(command.drive.speed - SPEED) < 1e-6 for command in commands]
        rates = [
            abs(after.drive.steering_angle - before.drive.steering_angle) / 0.01
            for before, after in zip(commands, commands[1:])
        ]
        print(f"{name}: G within {settled:.3f} m of the circle; /cmd is at the speed in ", end="")
        print(f"{sum(exact) / len(exact):.0%} and turns the wheels by at most {max(rates):.2f} rad/s")
        assert settled < 0.3 and sum(exact) > 0.5 * len(exact), (settled, sum(exact), len(exact))
        if name == "wall_follower":
            assert 0.99 * STEERING_RATE < max(rates) < 1.01 * STEERING_RATE, max(rates)
    log = (arguments.folder / "singletrack-ros.log").read_text()
    for field in ("acceleration", "jerk"):
        assert log.count(f"{field} is ignored") == 1, log
    assert "refused" not in log, log


def check_path(lab, system, arguments):
    circle = Circle(lab)
    drive(lab, system, "path", lambda: lab.path(circle.path()), arguments)
    settled = circle.errors[len(circle.errors) // 2 :]
    print(f"Path: P within {max(settled):.3f} m of its place on the circle")
    assert max(settled) < 0.25, max(settled)


def check_old(lab, system):
    """Stamps one second old are refused, and end a drive."""
    time.sleep(0.6)
    answer = lab.call("arm")
    assert not answer.success and "no set-points" in answer.message, answer.message
    every(0.02, 1.0, lambda: lab.velocity((0.1, 0.0), age=1.0))
    answer = lab.call("arm")
    assert not answer.success and "no set-points" in answer.message, answer.message
    wait("the count of old stamps", lambda: "old" in lab.refused.get("set-points refused", ""))
    passed = lab.refused["set-points passed on"]
    circle = Circle(lab)
    every(0.02, 0.6, lambda: lab.velocity(circle.velocity()))
    arm = lab.triggers["arm"].call_async(Trigger.Request())

    def until_driving():
        lab.velocity(circle.velocity())
        time.sleep(0.02)
        return arm.done()

    wait("the answer of arm", until_driving)
    assert arm.result().success, arm.result().message
    every(0.02, 1.0, lambda: lab.velocity(circle.velocity()))
    begin = time.monotonic()
    every(0.02, 0.6, lambda: lab.velocity(circle.velocity(), age=1.0))
    mode, reason = system.mode()
    assert mode != "driving" and reason == "setpoint-stale", (mode, reason)
    wait("the next count", lambda: lab.refused["set-points passed on"] != passed)
    print(f"stamps 1 s old: refused ({lab.refused['set-points refused']}); the drive ended: {reason}")
    wait("the car stands", lambda: system.mode()[0] in ("idle", "ready"))


def check_stalled(lab, system, arguments):
    """A reliable subscriber that is stopped changes nothing for the others and the daemon."""
    command = [sys.executable, __file__, *map(str, sys.argv[1:]), "--stall"]
    stalled = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert stalled.stdout.readline() == "subscribed\n"
        before = system.status()["figures"]
        stalled.send_signal(signal.SIGSTOP)
        begin = len(lab.arrived)
        time.sleep(arguments.stalled)
        count = len(lab.arrived) - begin
        after = system.status()["figures"]
        stalled.send_signal(signal.SIGCONT)
    finally:
        stalled.kill()
        stalled.wait()
    ticks = after["ticks"] - before["ticks"]
    print(f"a subscriber stopped for {arguments.stalled:.0f} s: {count} /odom of {ticks} ticks")
    # Before and after the two questions for the status, ticks go on.
    assert abs(count - ticks) <= 30, (count, ticks)
    for key in ("lateness_us", "tick_duration_us", "deadline_misses"):
        print(f"  {key}: {before[key]} before, {after[key]} after")


def check_killed(lab, system):
    """singletrack-ros is killed in the middle of a drive: the car stops at once."""
    circle = Circle(lab)
    every(0.02, 0.6, lambda: lab.velocity(circle.velocity()))
    arm = lab.triggers["arm"].call_async(Trigger.Request())
    while not arm.done():
        every(0.02, 0.02, lambda: lab.velocity(circle.velocity()))
    assert arm.result().success, arm.result().message
    every(0.02, 1.0, lambda: lab.velocity(circle.velocity()))
    lab.whole = len(lab.raw["odom"])
    begin = time.monotonic()
    system.processes["singletrack-ros"].kill()
    system.processes["singletrack-ros"].wait()
    wait("the stop", lambda: system.mode()[0] != "driving")
    took = time.monotonic() - begin
    assert system.mode()[1] == "operator-gone", system.mode()
    print(f"singletrack-ros killed: operator-gone, seen after {took * 1e3:.0f} ms")
    system.start_node()
    count = len(lab.raw["odom"])
    wait("the messages of the next process", lambda: len(lab.raw["odom"]) > count + 50)
    for client in lab.triggers.values():
        assert client.wait_for_service(10.0), "a service is missing"


def sockets(process):
    """The UDP ports at which a process alone takes datagrams for every address, and how many of
    them the kernel dropped. Those of multicast are shared."""
    inodes = set()
    for file in pathlib.Path(f"/proc/{process.pid}/fd").iterdir():
        if (match := re.fullmatch(r"socket:\[(\d+)\]", os.readlink(file))) is not None:
            inodes.add(match[1])
    lines = [line.split() for line in open("/proc/net/udp").readlines()[1:]]
    port = lambda line: int(line[1].split(":")[1], 16)
    ports = [port(line) for line in lines]
    return {
        port(line): int(line[12])
        for line in lines
        if line[9] in inodes and line[1].startswith("00000000:") and ports.count(port(line)) == 1
    }


def check_closed(system):
    """Datagrams from another address than loopback's do not reach the node."""
    process = system.processes["singletrack-ros"]
    subprocess.run(["ip", "address", "add", "10.9.9.9/32", "dev", "lo"], check=True)
    before = sockets(process)
    assert len(before) >= 2, before
    for source, count in (("127.0.0.1", 3), ("10.9.9.9", 5)):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.bind((source, 0))
            for port in before:
                for _ in range(count):
                    sender.sendto(b"RTPS", (source, port))
    dropped = [drops - before[port] for port, drops in sockets(process).items()]
    assert dropped == [5] * len(before), dropped
    print(f"from elsewhere: every datagram is dropped at {len(before)} sockets")


def check_stop(lab, system):
    assert lab.call("stop").success
    wait("the stop", lambda: system.mode()[1] == "emergency-stop")
    print("stop: emergency-stop")


def check_beside(executor, arguments):
    """Two cars with a daemon and a node each: each is heard and told in its own namespace."""
    node = Node("fleet")
    executor.add_node(node)
    places, stops, systems = {}, {}, {}
    try:
        for namespace, x, port in (("/car7", 0.5, 1510), ("/car8", -0.5, 1520)):
            folder = arguments.folder / namespace[1:]
            folder.mkdir()
            base = f"{namespace[1:]}/base_link"
            frames = ("--odom-frame", "map", "--base-frame", base)
            systems[namespace] = System(arguments, folder, namespace, f"{x},0,0", port, frames)

            def take(transforms, namespace=namespace, base=base):
                # Without odom there is one.
                (one,) = transforms.transforms
                assert (one.header.frame_id, one.child_frame_id) == ("map", base), one
                places[namespace] = one.transform.translation.x

            node.create_subscription(TFMessage, f"{namespace}/tf", take, RELIABLE)
            check_description(node, namespace, base)
            stops[namespace] = node.create_client(Trigger, f"{namespace}/stop")
        for namespace, stop in stops.items():
            assert stop.wait_for_service(10.0), f"{namespace}/stop is missing"
        near = lambda namespace, x: abs(places.get(namespace, 9.0) - x) < 0.2
        wait("both cars at their places", lambda: near("/car7", 0.5) and near("/car8", -0.5))
        answer = stops["/car8"].call_async(Trigger.Request())
        wait("an answer of stop", answer.done, 15.0)
        assert answer.result().success, answer.result().message
        wait("the stop", lambda: systems["/car8"].mode()[1] == "emergency-stop")
        assert systems["/car7"].mode()[1] != "emergency-stop", systems["/car7"].mode()
        print("two cars: each has its namespace, and one is stopped")
    finally:
        for system in systems.values():
            system.kill()


def padded(message):
    """A message as it is on the wire: in words of four bytes, with the padding's length."""
    return message[:2] + message[4:] + bytes(-len(message) % 4)


def check_bytes(lab, folder):
    """Every message is in the record, with the same bytes; and no /odom of it was lost."""
    (record,) = folder.glob("*.mcap")
    recorded = {channel: [] for channel, _ in TOPICS.values()}
    with open(record, "rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            if channel.topic in recorded:
                recorded[channel.topic].append(padded(message.data))
    received = {name: [padded(raw) for raw in raws] for name, raws in lab.raw.items()}
    # Until the process was killed.
    odom, ours = recorded["/odom"], received["odom"][: lab.whole]
    begin, end = odom.index(ours[0]), odom.index(ours[-1])
    print(f"/odom: {len(ours)} of {end - begin + 1}")
    lost = sorted(set(odom[begin : end + 1]) - set(ours), key=odom.index)
    places = [odom.index(message) - begin for message in lost[:5]]
    assert not lost, f"{len(lost)} lost, at {places}; singletrack-ros: {lab.refused}"
    assert ours == odom[begin : end + 1], "in another order, or twice"
    assert len(ours) > 1000
    counts = []
    recorded = {channel: set(messages) for channel, messages in recorded.items()}
    for name, (channel, _) in TOPICS.items():
        ours = [raw for raw in received[name] if raw not in recorded[channel]]
        if name == "diagnostics":
            # Those of singletrack-ros itself.
            ours = [raw for raw in ours if b"singletrack-ros" not in raw]
        if name == "/rosout":
            # Every node of this process writes there too.
            ours = [raw for raw in ours if raw and b"\0lab" not in raw and b"lab\0" not in raw]
        assert not ours, f"{name}: {len(ours)} of {len(lab.raw[name])} are not in the record"
        assert lab.raw[name], f"{name}: nothing"
        counts.append(f"{len(lab.raw[name])} {channel}")
    print("in the record, byte for byte:", ", ".join(counts))


def check_transforms(lab):
    """/tf has the chain of REP 105: map and odom as one, and the pose of /odom, at the same stamps."""
    poses = {}
    for raw in lab.raw["odom"]:
        message = deserialize_message(raw, Odometry)
        pose = message.pose.pose
        frames = message.header.frame_id, message.child_frame_id
        poses[seconds(message.header.stamp)] = frames, pose.position, pose.orientation
    compared = 0
    for raw in lab.raw["tf"]:
        fixed, car = deserialize_message(raw, TFMessage).transforms
        if (odometry := poses.get(seconds(car.header.stamp))) is None:
            continue
        frames, position, orientation = odometry
        assert frames == ("odom", "base_link"), frames
        assert (fixed.header.frame_id, fixed.child_frame_id) == ("map", "odom"), fixed
        assert fixed.header.stamp == car.header.stamp and fixed.transform.rotation.w == 1.0, fixed
        assert (car.header.frame_id, car.child_frame_id) == frames, car
        place = car.transform.translation
        assert (place.x, place.y, place.z) == (position.x, position.y, position.z), car
        assert car.transform.rotation == orientation, car
        compared += 1
    assert compared > 1000, compared
    print(f"/tf: {compared} times map -> odom -> base_link as in /odom")


def check_covariances(lab):
    """Those of what is estimated are small, and those of what is not are large: all can be fused."""
    known = [0, 1, 5]
    deviations = []
    for raw in lab.raw["odom"]:
        message = deserialize_message(raw, Odometry)
        for of in (message.pose, message.twist):
            matrix = numpy.reshape(of.covariance, (6, 6))
            assert (matrix == matrix.T).all() and numpy.linalg.eigvalsh(matrix).min() > 0.0, matrix
            variances = matrix.diagonal()
            assert (variances[[2, 3, 4]] == 1e6).all() and (variances[known] < 1.0).all(), matrix
            deviations.append(numpy.sqrt(variances[known]))
    for name, of in (("x, y, yaw", deviations[::2]), ("forward, left, yaw rate", deviations[1::2])):
        print(f"/odom: median deviations of {name}: {numpy.median(of, axis=0).round(5)}")


def check_description(node, namespace, base):
    """A subscriber that comes late gets the car, which needs no transform but that of its base."""
    got = []
    name = f"{namespace}/robot_description"
    subscription = node.create_subscription(String, name, got.append, LATCHED)
    wait(name, lambda: got)
    node.destroy_subscription(subscription)
    robot = xml.etree.ElementTree.fromstring(got[0].data)
    (link,) = robot.iter("link")
    assert link.get("name") == base, link.attrib
    assert len(link.findall("visual/geometry/cylinder")) == 4, got[0].data
    print(f"{name}: link {base} with {len(link)} shapes")


def check_messages(package):
    """The package of the record's own messages is one that ROS can build."""
    manifest = xml.etree.ElementTree.parse(package / "package.xml").getroot()
    assert manifest.findtext("name") == package.name, manifest
    assert "rosidl_interface_packages" in [group.text for group in manifest.iter("member_of_group")]
    files = sorted((package / "msg").glob("*.msg"))
    found = {path.stem: parse_message_file(package.name, path) for path in files}
    fields = [field.type for message in found.values() for field in message.fields]
    own = {field.type for field in fields if field.pkg_name == package.name}
    assert own < found.keys(), own - found.keys()
    print(f"singletrack_msgs: {len(found)} messages")


def report_setpoints(system, folder):
    """From the stamp of a set-point here to the beginning of the tick that obeyed it."""
    (record,) = folder.glob("*.mcap")
    command = [system.programs / "singletrack", "dump", record, "--topic", "tick"]
    ticks = subprocess.run([*command, "--format", "json"], check=True, capture_output=True).stdout
    delays = []
    for tick in map(json.loads, ticks.splitlines()):
        setpoints = [event["setpoint"] for event in tick["events"] if event["setpoint"]]
        delays += [(tick["start_ns"] - one["time_ns"]) * 1e-9 for one in setpoints]
    print(f"set-points, from their stamp to the next tick (10 ms): {quantiles(delays)}")


def stall():
    """Subscribes, and says so; it is then stopped."""
    rclpy.init()
    node = Node("stalled", namespace=NAMESPACE)
    count = [0]

    def take(_):
        count[0] += 1
        if count[0] == 20:
            print("subscribed", flush=True)

    node.create_subscription(Odometry, "odom", take, RELIABLE)
    rclpy.spin(node)


def main():
    arguments = ARGUMENTS.parse_args()
    if arguments.stall:
        stall()
        return
    begin = time.monotonic()
    lateness = Lateness()
    system = System(arguments, arguments.folder)
    rclpy.init()
    lab = Lab()
    executor = SingleThreadedExecutor()
    executor.add_node(lab)
    thread = threading.Thread(target=executor.spin, daemon=True)
    thread.start()
    try:
        wait("the mode idle or ready", lambda: system.mode()[0] in ("idle", "ready"))
        for client in lab.triggers.values():
            assert client.wait_for_service(10.0), "a service is missing"
        for publisher in (lab.velocities, lab.drives, lab.twists, lab.paths):
            wait("a match", lambda: publisher.get_subscription_count() > 0)
        wait("P", lambda: lab.point is not None and lab.odometry is not None)
        # What came while the nodes found each other may have gaps.
        time.sleep(0.5)
        for raws in lab.raw.values():
            raws.clear()
        check_messages(MESSAGES)
        check_description(lab, NAMESPACE, "base_link")
        check_latency(lab)
        check_velocity(lab, system, arguments)
        check_public(lab, system, arguments)
        check_path(lab, system, arguments)
        check_old(lab, system)
        check_stalled(lab, system, arguments)
        check_killed(lab, system)
        check_stop(lab, system)
        check_closed(system)
        system.end()
        check_bytes(lab, arguments.folder)
        check_transforms(lab)
        check_covariances(lab)
        report_setpoints(system, arguments.folder)
        check_beside(executor, arguments)
        print(f"{time.monotonic() - begin:.0f} s")
    except BaseException:
        for name in ("singletrackd", "singletrack-ros"):
            print(f"-- {name}:", (arguments.folder / f"{name}.log").read_text()[-3000:])
        print(f"this machine was at most {lateness.longest * 1e3:.0f} ms late")
        if lateness.longest > TOO_LATE:
            traceback.print_exc()
            system.kill()
            sys.stdout.flush()
            os._exit(REPEAT)
        raise
    finally:
        system.kill()
        # rclpy's threads do not end by themselves.
        sys.stdout.flush()
        executor.shutdown(0)
    os._exit(0)


main()
