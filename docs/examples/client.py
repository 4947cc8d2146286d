"""Drives the car by set-points, with plain Python: python3 client.py SOCKET [SECONDS]"""
import json
import socket
import sys
import threading
import time


class Client:
    """A connection to the daemon: one JSON object a line, in each direction.

    The path is that of the socket, or of the file with the token for its port."""

    def __init__(self, path):
        tcp = path.endswith(".token")
        self.socket = socket.socket(socket.AF_INET if tcp else socket.AF_UNIX)
        self.lines = self.socket.makefile("r")
        if tcp:
            with open(path) as file:
                key = json.load(file)
            # Otherwise seconds of old states are kept for a client that is slow.
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            self.socket.connect((key["address"], key["port"]))
            self.ask("token", token=key["token"])
        else:
            self.socket.connect(path)

    def send(self, command, **keys):
        line = json.dumps({"version": 2, "command": command, **keys})
        self.socket.sendall(line.encode() + b"\n")

    def read(self):
        return json.loads(self.lines.readline() or '{"ok":false,"error":"closed"}')

    def ask(self, command, **keys):
        self.send(command, **keys)
        answer = self.read()
        if not answer["ok"]:
            raise RuntimeError(answer["error"])
        return answer


def main(path, seconds=10.0):
    drive, states = Client(path), Client(path)
    states.ask("watch", topics=["state"])
    begin, sequence, asked = time.monotonic(), 0, False
    while time.monotonic() < begin + seconds:
        state = states.read()
        if "missed" in state:
            continue
        # The controller: slow, and to the left.
        sequence += 1
        drive.send("setpoint", steering_rad=0.15, speed_m_s=0.3,
                   time_ns=time.monotonic_ns(), sequence=sequence)
        if not asked and state["mode"] == "ready":
            drive.send("arm", attendance="hold")
            asked = True
            threading.Thread(target=report, args=[drive], daemon=True).start()
        if asked and sequence % 10 == 0:
            drive.send("hold")
    drive.send("disarm")
    sys.stdout.write(json.dumps(state) + "\n")


def report(drive):
    for line in drive.lines:
        print(line, end="")


if __name__ == "__main__":
    main(sys.argv[1], *map(float, sys.argv[2:3]))
