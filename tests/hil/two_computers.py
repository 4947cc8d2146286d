#!/usr/bin/env python3
"""Measures `singletrack fleet` with two cars on two computers, in real time.

The computers are two network namespaces with a cable between them, and the clock of the second one
is 100000 s ahead: its offset is known. Each has a simulated car and its daemon. The socket of the
second car is forwarded over the cable as `ssh -L` does, and with `--zenoh` by `singletrack-zenoh`,
whose processes are killed as well. Needs Linux with user namespaces, `unshare`, `ip` and Python 3.10,
and no other rights; nothing leaves the namespaces. Takes 20 s, with zenoh 50 s.

    cargo verify two-computers zenoh
"""

import contextlib
import json
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

AHEAD_S = 100_000
START_APART_S = 0.010
# Above this lateness of the machine, in s, a failure is not valid; with this exit status.
TOO_LATE_S = 0.04
NOT_VALID = 75
STOP_S = 0.2
PORT = 9_000
ADDRESSES = ["10.9.0.1", "10.9.0.2"]
ROUTER = f"tcp/{ADDRESSES[0]}:7447"
EXAMPLE = Path(__file__).parents[2] / "host/daemon/singletrackd.example.toml"


def relay(listener, connect):
    """Forwards each connection."""

    def copy(source, sink):
        with contextlib.suppress(OSError):
            while data := source.recv(65_536):
                sink.sendall(data)
        with contextlib.suppress(OSError):
            sink.shutdown(socket.SHUT_WR)

    def serve():
        while True:
            end, _ = listener.accept()
            try:
                ends = [end, connect()]
            except OSError:
                end.close()
                continue
            for pair in (ends, ends[::-1]):
                threading.Thread(target=copy, args=pair, daemon=True).start()

    threading.Thread(target=serve, daemon=True).start()


def unix(path):
    client = socket.socket(socket.AF_UNIX)
    client.connect(str(path))
    return client


def start(programs, folder):
    """Starts a simulated car and its daemon."""
    folder.mkdir()
    simulator = [programs / "singletrack-sim", "--port", folder / "board"]
    processes = [subprocess.Popen(simulator, stdout=subprocess.DEVNULL)]
    text = EXAMPLE.read_text()
    changes = {
        r"^port = .*": f'port = "{folder}/board"',
        r"^server = .*": 'server = "127.0.0.1"',
        r"^\[record\]": "[record]\nenabled = false",
        r"^\[state\]": f'[state]\ndirectory = "{folder}/state"',
        r"^\[socket\]": f'[socket]\npath = "{folder}/control.sock"',
    }
    for pattern, replacement in changes.items():
        text, count = re.subn(pattern, replacement, text, count=1, flags=re.M)
        assert count == 1, pattern
    config = folder / "car.toml"
    config.write_text(text)
    while not (folder / "board").exists():
        time.sleep(0.01)
    with (folder / "log").open("w") as log:
        daemon = [programs / "singletrackd", "--config", config]
        processes.append(subprocess.Popen(daemon, stdout=log, stderr=log))
    return processes


def ask(folder, command, **keys):
    """Sends a request; the lines of the answers."""
    client = unix(folder / "control.sock")
    client.sendall(json.dumps({"version": 3, "command": command, **keys}).encode() + b"\n")
    return (json.loads(line) for line in client.makefile())


def wait_ready(folder):
    for _ in range(400):
        try:
            status = next(ask(folder, "status"))["status"]
            if status["state"] and status["state"]["mode"] == "ready":
                return
        except OSError:
            status = None
        time.sleep(0.05)
    sys.exit(f"{folder.name} is not ready: {status and status['cameras']}")


class Watch(threading.Thread):
    """Notes when the reference of a car began and when it began to stop, in ns of this computer."""

    def __init__(self, folder, ahead_ns):
        super().__init__(daemon=True)
        self.states = ask(folder, "watch", topics=["state"])
        self.ahead_ns = ahead_ns
        self.begun = self.stopped = None
        self.start()

    def run(self):
        for state in self.states:
            if "mode" not in state:
                continue
            now = state["time_ns"] - self.ahead_ns
            if state["drive_time_s"] is not None:
                self.begun = self.begun or now - round(1e9 * state["drive_time_s"])
            if self.begun and state["mode"] not in ("driving", "slowing"):
                self.stopped = now
                return


class Lateness(threading.Thread):
    """The longest time for which this process was not run: its measurements may be late by as much."""

    def __init__(self):
        super().__init__(daemon=True)
        self.longest_s = 0.0
        self.start()

    def run(self):
        looked = time.monotonic()
        while True:
            time.sleep(0.001)
            now = time.monotonic()
            self.longest_s = max(self.longest_s, now - looked - 0.001)
            looked = now


class Zenoh:
    """A process of `singletrack-zenoh`."""

    def __init__(self, programs, *arguments):
        self.command = [programs / "singletrack-zenoh", *arguments]
        self.start()

    def start(self):
        self.process = subprocess.Popen(self.command, stderr=subprocess.DEVNULL)

    def kill(self):
        self.process.kill()
        self.process.wait()


def second(programs, folder, zenoh):
    """The second computer. A line of its input kills what serves the car, and another starts it anew."""
    sys.stdin.readline()
    for command in ("link set lo up", f"addr add {ADDRESSES[1]}/24 dev cable", "link set cable up"):
        subprocess.run(["ip", *command.split()], check=True)
    start(programs, folder)
    path = folder / "control.sock"
    if zenoh:
        car = ["car", "--name", "car2", "--socket", path, "--router", ROUTER]
        server = Zenoh(programs, *car)
        while sys.stdin.readline():
            server.kill()
            sys.stdin.readline()
            server.start()
    relay(socket.create_server((ADDRESSES[1], PORT)), lambda: unix(path))
    time.sleep(3_600)


def main(programs, root, zenoh):
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
    cars = [root / "car1", root / "car2"]
    unshare = ["unshare", "--net", "--time", "--monotonic", str(AHEAD_S), "--fork", "--kill-child"]
    other = subprocess.Popen(
        [*unshare, sys.executable, __file__, *sys.argv[1:], "--second", str(cars[1])],
        stdin=subprocess.PIPE,
        text=True,
    )
    children = Path(f"/proc/{other.pid}/task/{other.pid}/children")
    while not children.read_text().split():
        time.sleep(0.01)
    pid = children.read_text().split()[0]
    cable = f"link add cable type veth peer name cable netns {pid}"
    for command in (cable, f"addr add {ADDRESSES[0]}/24 dev cable", "link set cable up"):
        subprocess.run(["ip", *command.split()], check=True)
    print(file=other.stdin, flush=True)
    start(programs, cars[0])
    sockets = [cars[0] / "control.sock", root / "forwarded.sock"]
    entries = [f'[[car]]\nname = "car{n}"\nsocket = "{path}"\n' for n, path in enumerate(sockets, 1)]
    processes = {}
    if zenoh:
        entries.append(f'router = "{ROUTER}"\n')
    (root / "fleet.toml").write_text("".join(entries))
    if zenoh:
        listen = ["--listen", ROUTER, "--without-password"]
        processes["router"] = Zenoh(programs, "router", *listen)
        processes["desk"] = Zenoh(programs, "desk", "--fleet", root / "fleet.toml")
    else:
        forwarded = socket.socket(socket.AF_UNIX)
        forwarded.bind(str(sockets[1]))
        forwarded.listen()
        relay(forwarded, lambda: socket.create_connection((ADDRESSES[1], PORT)))

    fleet = [programs / "singletrack", "fleet", "--fleet", root / "fleet.toml"]

    def wait_all_ready():
        for folder in cars:
            wait_ready(folder)
        for _ in range(200):
            answer = subprocess.run([*fleet, "status"], capture_output=True, text=True)
            if answer.returncode == 0:
                return answer.stdout
            time.sleep(0.05)
        sys.exit(answer.stderr)

    status = wait_all_ready()
    clocks = re.findall(r"clock (\S+) ms ± (\S+)", status)
    for (offset, bound), truth in zip(clocks, (0, 1e3 * AHEAD_S), strict=True):
        error = float(offset) - truth
        print(f"offset of the clock: error {1e3 * error:.0f} us, bound {1e3 * float(bound):.0f} us")
        assert abs(error) <= float(bound) + 1e-3, status

    for failure in ("partition", "kill", "hang", *processes, *(["server"] if zenoh else [])):
        wait_all_ready()
        watches = [Watch(folder, ahead) for folder, ahead in zip(cars, (0, AHEAD_S * 10**9))]
        arm = subprocess.Popen([*fleet, "arm", "--uncalibrated", "--together", "--start-in", "1s"])
        while not all(watch.begun for watch in watches):
            assert arm.poll() is None, "not armed"
            time.sleep(0.01)
        apart = abs(watches[0].begun - watches[1].begun) / 1e9
        time.sleep(1)
        lateness = Lateness()
        failed = time.monotonic_ns()
        match failure:
            case "partition":
                subprocess.run(["ip", "link", "set", "cable", "down"], check=True)
            case "kill":
                arm.kill()
            case "hang":
                arm.send_signal(signal.SIGSTOP)
            case "server":
                print(file=other.stdin, flush=True)
            case process:
                processes[process].kill()
        for watch in watches:
            watch.join(5)
        after = [(watch.stopped - failed) / 1e9 for watch in watches]
        arm.kill()
        arm.wait()
        subprocess.run(["ip", "link", "set", "cable", "up"], check=True)
        if failure in processes:
            processes[failure].start()
        elif failure == "server":
            print(file=other.stdin, flush=True)
        begin = ", ".join(f"{1e3 * seconds:.0f} ms" for seconds in after)
        late = f"measured to {1e3 * lateness.longest_s:.0f} ms"
        print(f"{failure}: started {1e3 * apart:.3f} ms apart, begin to stop after {begin}, {late}")
        if apart >= START_APART_S or max(after) >= STOP_S + lateness.longest_s:
            sys.exit(NOT_VALID if lateness.longest_s > TOO_LATE_S else 1)


if __name__ == "__main__":
    programs = Path(sys.argv[1]).resolve()
    zenoh = "--zenoh" in sys.argv
    if "--second" in sys.argv:
        second(programs, Path(sys.argv[-1]), zenoh)
    elif "--inside" in sys.argv:
        with tempfile.TemporaryDirectory() as root:
            main(programs, Path(root), zenoh)
    else:
        inside = ["unshare", "--user", "--map-root-user", "--net", "--pid", "--fork", "--mount-proc"]
        if subprocess.run([*inside, "ip", "link", "show"], stdout=subprocess.DEVNULL).returncode:
            sys.exit(print("not run: this user may create no namespaces, or there is no `ip`"))
        command = [*inside, sys.executable, __file__, *sys.argv[1:], "--inside"]
        sys.exit(subprocess.run(command).returncode)
